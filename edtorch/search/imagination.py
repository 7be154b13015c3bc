"""Roll-outs of a policy in models drawn from the posterior: how likely is it to succeed?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from edtorch.search.plan import Cost, Plan
from edtorch.search.policy_descent import Weighted
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


def imagine_lifted(model: TickModel, cost: Cost, policy: Weighted, futures: Futures) -> Imagined:
    """Roll-outs of a stationary policy linear in the lift, as ``imagine_knots``."""
    given = (*policy.products, real(policy.weight))
    return _imagined("imagine_lifted", model, cost, given, futures, cost.ticks)


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
