"""Gauss-Newton through time from many starts at once (Li & Todorov, "Iterative linear quadratic
regulator design", 2004): the plans, and how many starts came to nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from edtorch.search.plan import Cost, Plan
from edtorch.search.program import kernels
from edtorch.search.tick_model import TickModel, real


@dataclass(frozen=True)
class Descent:
    """How a plan is improved.

    damping: Levenberg and Marquardt's, in the Hessian of the raw actions, at first; times
    ``easier`` after a step that lowered the cost, times ``harder`` after none did, and given up
    above ``most``.  Steps of 1, ``shorter``, shorter^2, ... are tried, ``tries`` of them.  largest:
    of a raw action.  It ends after ``limit`` iterations, or when the cost changes by less than
    ``tolerance`` of itself.
    """

    damping: float = 1e-3
    easier: float = 0.4
    harder: float = 6.0
    most: float = 1e5
    shorter: float = 0.4
    tries: int = 6
    largest: float = 3.0
    limit: int = 200
    tolerance: float = 1e-4


@dataclass(frozen=True)
class Found:
    """plans: in the order of their starts; dropped: starts whose roll-out is not finite;
    iterations: of each plan."""

    plans: tuple[Plan, ...]
    dropped: int
    iterations: tuple[int, ...]


DESCENT = Descent()


def shoot(
    model: TickModel, cost: Cost, starts: Sequence[Plan], descent: Descent = DESCENT
) -> Found:
    """Single shooting: each start's own roll-out from its first state, improved.

    The digits of a plan are the same whatever other starts there are.  Raises ValueError for
    arrays that do not fit each other, Unavailable where the kernels cannot be compiled.
    """
    arguments = (*planning_problem(model, cost), descent_of(descent))
    return _searched("shoot", arguments, cost, starts)


def connect(
    model: TickModel,
    cost: Cost,
    starts: Sequence[Plan],
    descent: Descent = DESCENT,
    per_gap: float = 10.0,
) -> Found:
    """Multiple shooting: the starts' states need not follow from each other.

    Differential dynamic programming with gaps (Mastalli et al., "Crocoddyl", 2020): what is
    lowered is the cost and ``per_gap`` times the lengths of the gaps between each state and the one
    that the model says.  Then single shooting from there, so that a plan is a roll-out of the
    model.  Errors as for ``shoot``.
    """
    arguments = (*planning_problem(model, cost), descent_of(descent), float(per_gap))
    return _searched("connect", arguments, cost, starts)


def descent_of(descent: Descent) -> tuple[Any, ...]:
    """The settings as kernels take them."""
    return astuple(descent)


def planning_problem(model: TickModel, cost: Cost) -> tuple[Any, ...]:
    """(model, weight, cost, bounds) as kernels take them.

    Raises ValueError for arrays that do not fit each other.
    """
    lift, m = model.structure.lift, len(model.half)
    entries = lift.action_at + m
    expected = {
        "weight of the model": (
            model.weight,
            (len(model.structure.learned), len(model.structure.terms.derivative)),
        ),
        "rows of the cost": (cost.rows, (len(cost.weight), cost.rows.shape[1], entries)),
        "weight of the action in the cost": (cost.action, (m,)),
        "middle of the actions": (model.middle, (m,)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"{name}: shape {array.shape}: expected {shape}")
    if np.any(cost.rows[..., lift.action_at :]):
        raise ValueError(
            "rows of the cost: expected 0 for the entries of the action, which Cost.action weighs"
        )
    weights = (real(cost.rows), real(cost.weight), real(cost.action), float(cost.squash))
    return model.parts, real(model.weight), weights, model.bounds


def _searched(kernel: str, arguments: tuple[Any, ...], cost: Cost, starts: Sequence[Plan]) -> Found:
    state, raw, gain = plan_arrays(starts, cost.ticks)
    value, count = np.full(len(starts), np.inf), np.zeros(len(starts), np.int64)
    kernels()[kernel](*arguments, state, raw, gain, value, count)
    kept = [r for r in range(len(starts)) if np.isfinite(value[r])]
    return Found(
        tuple(Plan(state[r], raw[r], gain[r], float(value[r])) for r in kept),
        len(starts) - len(kept),
        tuple(int(count[r]) for r in kept),
    )


def plan_arrays(starts: Sequence[Plan], ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Copies of the states, raw actions and gains of R plans ``[R, ...]``.

    Raises ValueError if there is none, or one is not of ``ticks`` ticks.
    """
    if not starts:
        raise ValueError("starts: expected one or more")
    for start in starts:
        if len(start.raw) != ticks:
            raise ValueError(
                f"starts: one of {len(start.raw)} ticks; expected {ticks}, the horizon of the cost"
            )
    return (
        np.stack([real(start.state) for start in starts]),
        np.stack([real(start.raw) for start in starts]),
        np.stack([real(start.gain) for start in starts]),
    )
