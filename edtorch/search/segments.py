"""Plans beyond the first horizon, one segment at a time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from torch import from_numpy

from edtorch.search.plan import Cost, Plan
from edtorch.search.shooting import DESCENT, Descent, connect, shoot
from edtorch.search.tick_model import TickModel

_STABLE = 12
"""The gains of the last ticks before an end are those of a short horizon; that many before it they
are settled."""


def plan_through(
    model: TickModel,
    cost: Cost,
    first: int,
    swings: Sequence[Plan],
    straight: Sequence[Plan],
    goal: np.ndarray,
    keep: int,
) -> tuple[list[Plan], int]:
    """The ``keep`` cheapest finite plans, the cheapest first, and how many starts failed.

    Over the first ``first`` ticks from ``swings`` by single shooting and from ``straight`` by
    multiple shooting; what is cheapest there goes on to the horizon of ``cost`` (``extend``).
    """
    opening = cost.part(0, first)
    found = [shoot(model, opening, swings)] if swings else []
    found += [connect(model, opening, straight)] if straight else []
    plans = sorted((p for each in found for p in each.plans), key=lambda plan: plan.cost)[:keep]
    dropped = sum(each.dropped for each in found)
    if first == cost.ticks:
        return plans, dropped
    longer = [extend(model, cost, plan, goal) for plan in plans]
    whole = sorted((plan for plan in longer if plan is not None), key=lambda plan: plan.cost)
    return whole, dropped + len(plans) - len(whole)


def extend(
    model: TickModel,
    cost: Cost,
    plan: Plan,
    goal: np.ndarray,
    grow: int = 10,
    descent: Descent = DESCENT,
) -> Plan | None:
    """A plan that goes on to the horizon of ``cost``, T ticks.

    What follows the plan is planned by single shooting from its end, with a horizon that grows by
    ``grow`` ticks a time: new ticks start with the gain that held 12 ticks before the end, about
    the states ``goal`` ``[T + 1, n]``.  A single plan over a long horizon moves too fast, and its
    gains are large.  The plan itself stays; the cost returned is its own and that of the ticks
    after it in ``cost``.  None where a segment failed.  Raises ValueError for arrays that do not
    fit each other, Unavailable where the kernels cannot be compiled.
    """
    first, last = len(plan.raw), cost.ticks
    if last <= first:
        raise ValueError(f"cost: {last} ticks: expected more than the {first} of the plan")
    if goal.shape != (last + 1, plan.state.shape[1]):
        raise ValueError(f"goal: shape {goal.shape}: expected {(last + 1, plan.state.shape[1])}")
    whole = plan
    for end in [*range(first + grow, last, grow), last]:
        start = _after(_grown(model, whole, goal, end), first)
        found = shoot(model, cost.part(first, end), [start], descent).plans
        if not found:
            return None
        whole = _joined(plan, found[0])
    return whole


def _grown(model: TickModel, plan: Plan, goal: np.ndarray, end: int) -> Plan:
    """With ticks up to ``end`` that hold the goal."""
    ticks, m = plan.raw.shape
    gain, more = plan.gain[max(0, ticks - _STABLE)], end - ticks
    raw = np.zeros((more, m))
    # At the first of them the plan's own state is the reference, so that its action says the rest.
    away = model.structure.difference(from_numpy(plan.state[-1]), from_numpy(goal[ticks]))
    raw[0] = gain @ away.numpy()
    return Plan(
        np.concatenate((plan.state, goal[ticks + 1 : end + 1])),
        np.concatenate((plan.raw, raw)),
        np.concatenate((plan.gain, np.tile(gain, (more, 1, 1)))),
        plan.cost,
    )


def _after(plan: Plan, first: int) -> Plan:
    return Plan(plan.state[first:], plan.raw[first:], plan.gain[first:], plan.cost)


def _joined(plan: Plan, segment: Plan) -> Plan:
    return Plan(
        np.concatenate((plan.state[:-1], segment.state)),
        np.concatenate((plan.raw, segment.raw)),
        np.concatenate((plan.gain, segment.gain)),
        plan.cost + segment.cost,
    )
