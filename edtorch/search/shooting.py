"""Gauss-Newton through time from many starts at once (Li & Todorov, "Iterative linear quadratic
regulator design", 2004): the plans, and how many starts failed."""

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
    ``easier`` after an iteration that lowered the cost, times ``harder`` after one that hardly did
    (by less than ``tolerance`` of it), and given up above ``most``.  Of the steps 1, ``shorter``,
    shorter^2, ..., ``tries`` of them, the first is taken that is better than the next.  largest: of
    a raw action.  It ends after ``limit`` iterations, or when a whole step hardly lowers the cost.
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
    problem = planning_problem(model, cost)
    return _found([_shot(problem, start, descent) for start in _checked(starts, cost)])


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
    problem, found = planning_problem(model, cost), []
    for start in _checked(starts, cost):
        _, gap = expand(problem, start)
        linked, count = _descended(problem, start, gap, descent, per_gap)
        plan, more = _shot(problem, linked, descent)
        found.append((plan, count + more))
    return _found(found)


def expand(problem: tuple[Any, ...], plan: Plan) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """The expansion along a plan, as the kernel ``expand`` says, and the gaps ``[H, n]``."""
    (ticks, m), n = plan.raw.shape, plan.state.shape[1]
    shapes = [(ticks, n, n), (ticks, n, m), (ticks + 1, n), (ticks + 1, n, n)]
    expansion = tuple(np.zeros(shape) for shape in [*shapes, (ticks, m), (ticks, m)])
    gap = np.zeros((ticks, n))
    kernels()["expand"](*problem, real(plan.state), real(plan.raw), expansion, gap)
    return expansion, gap


def _shot(problem: tuple[Any, ...], start: Plan, descent: Descent) -> tuple[Plan, int]:
    given = (real(start.state), real(start.raw), real(start.gain))
    state, raw = given[0].copy(), given[1].copy()
    cost = kernels()["rolled"](*problem, float(descent.largest), given, (state, raw))
    rolled = Plan(state, raw, start.gain, cost)
    return _descended(problem, rolled, np.zeros((len(raw), state.shape[1])), descent, 0.0)


def _descended(
    problem: tuple[Any, ...], start: Plan, gap: np.ndarray, descent: Descent, per_gap: float
) -> tuple[Plan, int]:
    state, raw, gain = (real(part).copy() for part in (start.state, start.raw, start.gain))
    merit, count = kernels()["descend"](
        *(*problem, astuple(descent), state, raw, gain, gap, float(per_gap))
    )
    return Plan(state, raw, gain, merit), count


def _checked(starts: Sequence[Plan], cost: Cost) -> Sequence[Plan]:
    """Raises ValueError if there is none, or one is not of the cost's horizon."""
    if not starts:
        raise ValueError("starts: expected one or more")
    for start in starts:
        if len(start.raw) != cost.ticks:
            raise ValueError(
                f"starts: one of {len(start.raw)} ticks; expected {cost.ticks}, the horizon of the"
                " cost"
            )
    return starts


def _found(found: Sequence[tuple[Plan, int]]) -> Found:
    kept = [(plan, count) for plan, count in found if np.isfinite(plan.cost)]
    plans = tuple(plan for plan, _ in kept)
    return Found(plans, len(found) - len(kept), tuple(count for _, count in kept))


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
