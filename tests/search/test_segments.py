"""Plans that go on beyond their first horizon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edtorch.search.plan import Cost
from edtorch.search.segments import extend, plan_through
from edtorch.search.shooting import Descent, connect, shoot
from edtorch.search.starts import lines, sinusoids, still
from edtorch.search.tick_model import TickModel
from tests.planning import (
    HANGING,
    oscillator,
    oscillator_cost,
    swing_up,
    swing_up_cost,
    tick_once,
    tip_error,
)


def test_on_a_linear_system_a_segment_is_optimal_from_where_it_starts() -> None:
    model, start = oscillator(), np.array([0.4, -0.2])
    cost = oscillator_cost(model, 45)
    exact = Descent(damping=1e-6, tolerance=1e-12)
    (plan,) = shoot(model, cost.part(0, 20), [still(start, np.zeros((20, 1)))], exact).plans
    longer = extend(model, cost, plan, np.zeros((46, 2)), descent=exact)
    assert longer is not None and longer.state.shape == (46, 2) and longer.gain.shape == (45, 1, 2)
    assert (longer.state[:21] == plan.state).all() and (longer.raw[:20] == plan.raw).all()
    (end,) = shoot(
        model, cost.part(20, 45), [still(plan.state[-1], np.zeros((25, 1)))], exact
    ).plans
    np.testing.assert_allclose(longer.state[20:], end.state, atol=1e-6)
    assert longer.cost == pytest.approx(plan.cost + end.cost, rel=1e-9)


def test_it_is_a_roll_out_of_the_model() -> None:
    model = swing_up()
    upright = np.zeros(4)
    cost = swing_up_cost(model, 35, power=0.0)
    start = np.array([0.1, 0.0, 0.1, 0.0])
    (plan,) = shoot(model, cost.part(0, 15), [still(start, np.zeros((15, 1)))]).plans
    longer = extend(model, cost, plan, np.tile(upright, (36, 1)))
    assert longer is not None
    for t in range(35):
        after, _ = tick_once(model, model.weight, longer.state[t], np.tanh(longer.raw[t]))
        np.testing.assert_allclose(after, longer.state[t + 1], atol=1e-12)
    assert (tip_error(longer.state[30:]) < 0.05).all()


def test_what_does_not_fit_is_named() -> None:
    model = oscillator()
    plan = still(np.zeros(2), np.zeros((30, 1)))
    with pytest.raises(ValueError, match="30 ticks: expected more than the 30 of the plan"):
        extend(model, oscillator_cost(model, 30), plan, np.zeros((31, 2)))
    with pytest.raises(ValueError, match=r"goal: shape \(31, 2\): expected \(41, 2\)"):
        extend(model, oscillator_cost(model, 40), plan, np.zeros((31, 2)))


def test_the_cheapest_plans_go_on_to_the_end() -> None:
    model, start, goal = oscillator(), np.array([0.4, -0.2]), np.zeros((31, 2))
    cost = oscillator_cost(model, 30)
    swings = sinusoids(start, 15, 1, model.dt, 3, np.random.default_rng(0))
    lost = still(np.array([np.nan, 0.0]), np.zeros((15, 1)))
    straight = lines(model.structure, start, goal[15], 15, 1, model.dt, np.random.default_rng(1))
    plans, dropped = plan_through(model, cost, 15, [*swings, lost], straight, goal, keep=2)
    assert len(plans) == 2 and dropped == 1 and plans[0].cost <= plans[1].cost
    opening = shoot(model, cost.part(0, 15), swings).plans
    best = extend(model, cost, min(opening, key=lambda plan: plan.cost), goal)
    assert best is not None and plans[0].cost == pytest.approx(best.cost, rel=1e-3)
    whole, _ = plan_through(model, cost, 30, [still(start, np.zeros((30, 1)))], [], goal, keep=2)
    assert whole[0].cost < plans[0].cost


def _tracking_cost(model: TickModel, ticks: int, first: int) -> tuple[Cost, np.ndarray]:
    """The tip on .5 sin(2 pi t / 4 s), after a ramp of ``first`` ticks; and the states there."""
    cost, seconds = swing_up_cost(model, ticks, power=0.0), model.dt * np.arange(ticks + 1)
    phase, rows, goal = np.pi / 2 * seconds, cost.rows.copy(), np.zeros((ticks + 1, 4))
    goal[:, 0] = 0.5 * np.sin(phase)
    goal[:, 1] = 0.5 * np.pi / 2 * np.cos(phase) / 3
    rows[:, 0, 0] = -2 * goal[:, 0]
    weight = np.minimum(np.arange(ticks + 1) / first, 1.0) ** 4
    return replace(cost, rows=rows, weight=weight), goal


@pytest.mark.experiment
def test_a_tip_swings_up_and_follows_a_sine() -> None:
    model = swing_up()
    cost, goal = _tracking_cost(model, 100, 40)
    generator = np.random.default_rng(0)
    straight = lines(model.structure, HANGING, goal[40], 40, 1, model.dt, generator)
    for plan in connect(model, cost.part(0, 40), straight).plans:
        longer = extend(model, cost, plan, goal)
        assert longer is not None
        across = longer.state[:, 0] - 0.5 * np.sin(longer.state[:, 2]) - goal[:, 0]
        up = 0.5 * np.cos(longer.state[:, 2]) - 0.5
        assert (np.hypot(across, up)[40:] < 0.05).all() and np.abs(longer.gain).max() < 50
