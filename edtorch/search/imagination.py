"""Roll-outs of a plan in models that may be true: how likely is it to succeed?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edtorch.search.plan import Cost, Plan
from edtorch.search.program import kernels
from edtorch.search.shooting import planning_problem
from edtorch.search.tick_model import TickModel, real


@dataclass(frozen=True, eq=False)
class Imagined:
    """state ``[P, H + 1, n]``, nan after a roll-out ceased to be finite; cost ``[P]``, inf there;
    finite ``[P]``."""

    state: np.ndarray
    cost: np.ndarray
    finite: np.ndarray


def imagine(
    model: TickModel,
    cost: Cost,
    plan: Plan,
    weight: np.ndarray,
    start: np.ndarray,
    noise: np.ndarray,
) -> Imagined:
    """P roll-outs of a plan, each with its own weights of the model, held throughout.

    weight ``[P, L, K]``; start ``[P, n]``; noise ``[P, H, n]``: what is added to the state in the
    reading that the plan's gains act on, scaled.  The cost is ``Cost`` with the actions as they
    were and the squash of the plan's own raw actions.  Raises ValueError for arrays that do not
    fit each other, Unavailable where the kernels cannot be compiled.
    """
    parts, _, weights, bounds = planning_problem(model, cost)
    size, (ticks, n) = len(weight), (len(plan.raw), plan.state.shape[1])
    expected = {
        "weight": (weight, (size, *model.weight.shape)),
        "start": (start, (size, n)),
        "noise": (noise, (size, ticks, n)),
        "weight of the cost": (cost.weight, (ticks + 1,)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"{name}: shape {array.shape}: expected {shape}")
    state, value = np.zeros((size, ticks + 1, n)), np.zeros(size)
    given = (real(plan.state), real(plan.raw), real(plan.gain))
    kernels()["imagine"](
        *(parts, real(weight), weights, bounds, given, real(start), real(noise), state, value)
    )
    return Imagined(state, value, np.isfinite(value))
