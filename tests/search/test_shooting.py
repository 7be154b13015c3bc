"""Planning against closed forms: Riccati's equation, finite differences, one way beside another."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from edtorch.errors import Unavailable
from edtorch.search.plan import Cost, Plan
from edtorch.search.program import kernels, planner_source
from edtorch.search.shooting import Descent, Found, connect, expand, planning_problem, shoot
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


def riccati(model: TickModel, cost: Cost) -> tuple[np.ndarray, np.ndarray]:
    """Cost to go ``[2, 2]`` at the start, and gains ``[H, m, 2]`` of the forces."""
    _, by = tick_once(model, model.weight, np.zeros(2), np.zeros(len(model.half)))
    a, b = by[:, :2], by[:, 2:]
    ahead, gains = np.zeros((2, 2)), []
    for t in range(cost.ticks, 0, -1):
        row = cost.rows[t][:, 1:3]
        ahead = ahead + cost.weight[t] * row.T @ row
        effort = b.T @ ahead @ b + np.diag(cost.action / model.half**2)
        gain = -np.linalg.solve(effort, b.T @ ahead @ a)
        gains.append(gain)
        ahead = a.T @ ahead @ (a + b @ gain)
    return ahead, np.array(gains[::-1])


@pytest.mark.parametrize("push", [(1.0,), (1.0, -0.4, 0.2)])
@pytest.mark.parametrize("search", [shoot, connect])
def test_on_a_linear_system_a_plan_is_riccatis(
    search: Callable[..., Found], push: tuple[float, ...]
) -> None:
    model, start, m = oscillator(push), np.array([0.4, -0.2]), len(push)
    cost = oscillator_cost(model)
    exact = Descent(damping=1e-6, tolerance=1e-14)
    (plan,) = search(model, cost, [still(start, np.zeros((30, m)))], exact).plans
    ahead, gains = riccati(model, cost)
    assert plan.cost == pytest.approx(start @ ahead @ start, rel=1e-6)
    np.testing.assert_allclose(model.half[:, None] * plan.gain, gains, rtol=1e-5, atol=1e-6)
    actions = model.half * np.tanh(plan.raw)
    expected = (gains @ plan.state[:-1, :, None])[..., 0]
    np.testing.assert_allclose(actions, expected, rtol=1e-4, atol=1e-6)


def cost_by_hand(model: TickModel, cost: Cost, start: np.ndarray, raw: np.ndarray) -> float:
    state, total = start.copy(), 0.0
    for t, z in enumerate(raw):
        total += float(cost.action @ np.tanh(z) ** 2 + cost.squash * z @ z)
        action = model.middle + model.half * np.tanh(z)
        state, _ = tick_once(model, model.weight, state, action)
        sin, cos = math.sin(state[2]), math.cos(state[2])
        entry = np.array([1.0, state[0], state[1], sin, cos, state[3], 0.0])
        total += float(cost.weight[t + 1] * ((cost.rows[t + 1] @ entry) ** 2).sum())
    return total


def _waves(model: TickModel, cost: Cost, count: int, seed: int = 0) -> list[Plan]:
    generator = np.random.default_rng(seed)
    return sinusoids(HANGING, cost.ticks, 1, model.dt, count, generator)


def test_the_cost_is_the_sum_that_it_says() -> None:
    model = swing_up()
    cost = swing_up_cost(model, ticks=12)
    (start,) = _waves(model, cost, 1)
    (plan,) = shoot(model, cost, [start], Descent(limit=0)).plans
    assert plan.cost == pytest.approx(cost_by_hand(model, cost, HANGING, start.raw), rel=1e-12)


def test_the_gradient_is_that_of_finite_differences() -> None:
    model = swing_up()
    cost = replace(swing_up_cost(model, ticks=12, power=1.0), squash=0.03)
    (start,) = _waves(model, cost, 1)
    (plan,) = shoot(model, cost, [start], Descent(limit=0)).plans
    # With a damping out of all proportion a step is the gradient divided by it.
    feed, damping = np.zeros((12, 1)), 1e12
    expansion, gap = expand(planning_problem(model, cost), plan)
    np.testing.assert_allclose(gap, 0.0, atol=1e-15)
    given = (expansion, gap, damping)
    kernels()["backward"](*given, feed, np.zeros((12, 1, 4)))
    for t in range(12):
        raw = np.stack([start.raw, start.raw])
        raw[:, t, 0] += (-1e-5, 1e-5)
        low, high = (cost_by_hand(model, cost, HANGING, one) for one in raw)
        assert -damping * feed[t, 0] == pytest.approx((high - low) / 2e-5, rel=1e-5, abs=1e-7)


def test_without_gaps_multiple_shooting_is_single_shooting() -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    (start,) = _waves(model, cost, 1)
    few = Descent(limit=20)
    (consistent,) = shoot(model, cost, [start], Descent(limit=0)).plans
    (single,) = shoot(model, cost, [start], few).plans
    # Multiple shooting ends with a second single shooting.
    (single,) = shoot(model, cost, [single], few).plans
    (multiple,) = connect(model, cost, [consistent], few).plans
    np.testing.assert_allclose(multiple.state, single.state, rtol=1e-9, atol=1e-9)
    assert multiple.cost == pytest.approx(single.cost, rel=1e-10)


@pytest.mark.parametrize("search", [shoot, connect])
def test_a_start_has_the_same_digits_alone_and_among_others(search: Callable[..., Found]) -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    starts = _waves(model, cost, 3)
    few = Descent(limit=10)
    together = search(model, cost, starts, few).plans
    for start, plan in zip(starts, together, strict=True):
        (alone,) = search(model, cost, [start], few).plans
        assert alone.cost == plan.cost and (alone.state == plan.state).all()
        assert (alone.raw == plan.raw).all() and (alone.gain == plan.gain).all()


@pytest.mark.parametrize("search", [shoot, connect])
def test_a_start_that_is_not_finite_is_dropped(search: Callable[..., Found]) -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    good, bad = _waves(model, cost, 2)
    broken = replace(bad, raw=np.full_like(bad.raw, np.nan))
    found = search(model, cost, [broken, good, broken], Descent(limit=5))
    assert found.dropped == 2 and len(found.plans) == len(found.iterations) == 1


def test_what_does_not_fit_is_named() -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    starts = _waves(model, cost, 1)
    with pytest.raises(ValueError, match=r"one of 40 ticks; expected 20"):
        shoot(model, swing_up_cost(model, ticks=20), starts)
    with pytest.raises(ValueError, match="starts: expected one or more"):
        shoot(model, cost, [])
    rows = cost.rows.copy()
    rows[3, 0, -1] = 1.0
    with pytest.raises(ValueError, match=r"rows of the cost: .*Cost\.action"):
        shoot(model, replace(cost, rows=rows), starts)
    with pytest.raises(ValueError, match=r"action in the cost: shape \(2,\): expected \(1,\)"):
        shoot(model, replace(cost, action=np.ones(2)), starts)


def test_without_numba_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    kernels.cache_clear()
    model = swing_up()
    cost = swing_up_cost(model)
    with pytest.raises(Unavailable, match="numba cannot be imported"):
        shoot(model, cost, _waves(model, cost, 1))


def test_compiled_it_computes_what_it_says() -> None:
    """The text run by Python itself, to rounding; from states with gaps."""
    model = swing_up()
    cost = swing_up_cost(model, ticks=3)
    names: dict[str, Any] = {"outer": lambda function: function}
    exec(planner_source().text, names)
    found, settings = [], (1e-3, 0.4, 6.0, 1e5, 0.4, 6, 3.0, 2, 1e-4)
    for function in (names["descend"], kernels()["descend"]):
        state, raw = np.tile(HANGING, (4, 1)), np.full((3, 1), 0.2)
        gain, gap = np.zeros((3, 1, 4)), np.full((3, 4), 0.01)
        merit, count = function(
            *(*planning_problem(model, cost), settings, state, raw, gain, gap, 10.0)
        )
        found.append((state, raw, gain, gap, merit, count))
    for python, compiled in zip(*found, strict=True):
        np.testing.assert_allclose(python, compiled, rtol=1e-9, atol=1e-9)


def _swings_up(plan: Plan) -> bool:
    """Whether the tip is within .25 m of upright throughout the last second."""
    return bool((tip_error(plan.state[-10:]) < 0.25).all())


@pytest.mark.experiment
def test_nearly_every_start_swings_the_pole_up() -> None:
    """All 6 where this was written; what a search finds may depend on the last digit."""
    model = swing_up()
    cost = swing_up_cost(model)
    plans = shoot(model, cost, _waves(model, cost, 6)).plans
    assert sum(map(_swings_up, plans)) >= 5


@pytest.mark.experiment
def test_lines_swing_the_pole_up() -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    generator = np.random.default_rng(0)
    straight = lines(model.structure, HANGING, np.zeros(4), 40, 1, model.dt, generator)
    assert all(map(_swings_up, connect(model, cost, straight).plans))
