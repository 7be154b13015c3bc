"""Roll-outs of a policy in models drawn from the posterior: how likely is it to succeed?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.policy.bounded import BoundedPolicy
from edtorch.search.plan import Cost, Plan
from edtorch.search.program import kernels
from edtorch.search.shooting import planning_problem
from edtorch.search.tick_costs import TickCosts
from edtorch.search.tick_model import TickModel, real
from edtorch.search.ticks import drawn_ticks
from edtorch.types import Parameters


@dataclass(frozen=True, eq=False)
class Imagined:
    """state ``[P, H + 1, n]``, nan after a roll-out ceased to be finite; cost ``[P]``, inf there;
    finite ``[P]``."""

    state: np.ndarray
    cost: np.ndarray
    finite: np.ndarray


@dataclass(frozen=True, eq=False)
class Futures:
    """P random futures of H ticks, scaled: weights of the model ``[P, L, K]``, held throughout;
    starts ``[P, n]``; noise ``[P, H, n]``: what is added to the state in a reading."""

    weight: np.ndarray
    start: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True, eq=False)
class Knots:
    """k local policies: state ``[k, n]``, raw ``[k, m]``, gain ``[k, m, n]``, factor ``[k]``,
    metric ``[n]`` and width as ``edtorch.policy.knots.KnotPolicy`` has them."""

    state: np.ndarray
    raw: np.ndarray
    gain: np.ndarray
    factor: np.ndarray
    metric: np.ndarray
    width: float


def imagine(model: TickModel, cost: Cost, plan: Plan, futures: Futures) -> Imagined:
    """Roll-outs of a plan.

    The cost is ``Cost`` with the actions as they were and the squash of the policy's own raw
    actions.  Raises ValueError for arrays that do not fit each other, Unavailable where the kernels
    cannot be compiled.
    """
    given = (real(plan.state), real(plan.raw), real(plan.gain))
    return _imagined("imagine", model, cost, given, futures, len(plan.raw))


def imagine_knots(model: TickModel, cost: Cost, knots: Knots, futures: Futures) -> Imagined:
    """Roll-outs of a stationary policy, over the horizon of ``cost``; the rest as ``imagine``."""
    arrays = (knots.state, knots.raw, knots.gain, knots.factor, knots.metric)
    given = (*(real(array) for array in arrays), float(knots.width))
    return _imagined("imagine_knots", model, cost, given, futures, cost.ticks)


def imagine_policies(
    model: TickModel,
    cost: Cost,
    policy: BoundedPolicy,
    parameters: Parameters,
    futures: Futures,
) -> list[Imagined]:
    """Roll-outs of C stationary policies, ``[C, ...]`` each, all of them side by side in the same
    futures, over the horizon of ``cost``; the rest as ``imagine``."""
    size = len(next(iter(parameters.values())))
    state = torch.from_numpy(futures.start).unsqueeze(1).expand(-1, size, -1)
    noise, states, raws = torch.from_numpy(futures.noise), [state], list[Tensor]()
    with torch.no_grad():
        for t in range(cost.ticks):
            raws.append(policy.raw(parameters, state + noise[:, t].unsqueeze(1)))
            state = drawn_ticks(model, futures.weight, state, policy.squash(raws[-1]))
            states.append(state)
        raws.append(torch.zeros_like(raws[-1]))
        costs = TickCosts(model.structure.lift, cost)
        value = costs(torch.stack(states), torch.stack(raws)).sum(0).numpy()
    course, finite = torch.stack(states, dim=2).numpy(), np.isfinite(value)
    value = np.where(finite, value, np.inf)
    return [Imagined(course[:, c], value[:, c], finite[:, c]) for c in range(size)]


def _imagined(
    kernel: str,
    model: TickModel,
    cost: Cost,
    policy: tuple[Any, ...],
    futures: Futures,
    ticks: int,
) -> Imagined:
    parts, _, weights, bounds = planning_problem(model, cost)
    size, n = len(futures.weight), len(model.structure.source)
    expected = {
        "weight": (futures.weight, (size, *model.weight.shape)),
        "start": (futures.start, (size, n)),
        "noise": (futures.noise, (size, ticks, n)),
        "weight of the cost": (cost.weight, (ticks + 1,)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"{name}: shape {array.shape}: expected {shape}")
    state, value = np.zeros((size, ticks + 1, n)), np.zeros(size)
    given = (real(futures.start), real(futures.noise))
    kernels()[kernel](*(parts, real(futures.weight), weights, bounds, policy, *given, state, value))
    return Imagined(state, value, np.isfinite(value))
