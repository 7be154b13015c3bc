"""Policies of knots from plans, and the knot at the goal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from edtorch.errors import NoPlan
from edtorch.policy.knots import KnotPolicy
from edtorch.policy.squash import Squash
from edtorch.search.imagination import Futures
from edtorch.search.shooting import shoot
from edtorch.search.starts import sinusoids
from edtorch.search.stationary import Stationary, goal_knot
from edtorch.value.linear.stationary import regulator_at
from tests.planning import (
    HANGING,
    oscillator,
    oscillator_cost,
    search_problem,
    swing_up,
    swing_up_cost,
    tick_once,
    tip_error,
)


def test_the_goal_has_the_regulator_in_raw_actions() -> None:
    """A weight in the way: the action that holds it is not zero, nor is the middle of the range."""
    model = replace(oscillator(), middle=np.array([0.5]), half=np.array([3.0]))
    cost = oscillator_cost(model, 5)
    cost.rows[:, 0, 0] = -0.4  # x is wanted at 0.4, where u = -0.8 holds it
    problem = replace(search_problem(model, cost), goal=torch.tensor([[0.4, 0.0]]).double())
    knot = goal_knot(problem, model, cost)
    np.testing.assert_allclose(knot.state, [[0.4, 0.0]] * 2, atol=1e-9)
    action = 0.5 + 3 * np.tanh(knot.raw[0])
    np.testing.assert_allclose(action, -2 * knot.state[0, :1], atol=1e-5)
    found = regulator_at(
        *(model.structure, torch.from_numpy(model.weight), problem.goal[0]),
        *(torch.ones(2).bool(), problem.middle, problem.half, model.dt),
        *(torch.from_numpy(cost.rows[-1]), torch.from_numpy(cost.action)),
    )
    small = 1e-5 * np.eye(2)
    for i in range(2):
        moved = 0.5 + 3 * np.tanh(knot.raw[0] + knot.gain[0] @ small[i])
        np.testing.assert_allclose((moved - action) / 1e-5, found.gain[:, i].numpy(), rtol=1e-3)


def test_a_goal_that_cannot_be_held_is_no_plan() -> None:
    model = oscillator()
    weak = replace(model, weight=model.weight * np.array([1.0, 1.0, 0.0]))
    cost = oscillator_cost(weak, 5)
    with pytest.raises(NoPlan, match="the goal cannot be held"):
        goal_knot(search_problem(weak, cost), weak, cost)


def test_a_swing_up_is_held_for_longer_than_its_plan() -> None:
    """And what is imagined is what the policy does."""
    model, noise = swing_up(), np.random.default_rng(1)
    whole = swing_up_cost(model, 80)
    cost = swing_up_cost(model, 40)
    starts = sinusoids(HANGING, 40, 1, model.dt, 2, np.random.default_rng(0))
    plan = shoot(model, cost, starts).plans[0]
    problem, kind = search_problem(model, whole), Stationary()
    futures = Futures(
        weight=np.tile(model.weight, (6, 1, 1)),
        start=HANGING + 0.05 * noise.standard_normal((6, 4)),
        noise=0.003 * noise.standard_normal((6, 80, 4)),
    )
    (carried,) = kind.carried(problem, model, whole, [plan], futures)
    for state in carried.imagined.state:
        assert (tip_error(state[35:]) < 0.25).all()
    policy, memory = kind.actor(problem, 40)
    assert memory is None and isinstance(policy, KnotPolicy)
    parameters = {k: torch.from_numpy(p)[None] for k, p in carried.parameters.items()}
    assert {k: p.shape for k, p in parameters.items()} == {
        k: p.shape for k, p in policy.initial([0]).items()
    }
    seen = futures.start[0]
    for t in range(80):
        np.testing.assert_allclose(carried.imagined.state[0, t], seen, rtol=1e-6, atol=1e-6)
        reading = torch.from_numpy(carried.imagined.state[0, t] + futures.noise[0, t])
        action = policy.action(parameters, reading[None])[0].numpy()
        seen, _ = tick_once(model, model.weight, carried.imagined.state[0, t], action)


def test_the_nearest_knot_alone_is_a_width_of_zero() -> None:
    model = oscillator()
    cost, start = oscillator_cost(model, 30), np.array([0.4, -0.2])
    (plan,) = shoot(model, cost, sinusoids(start, 30, 1, 0.1, 1, np.random.default_rng(0))).plans
    futures = Futures(model.weight[None], start[None], np.zeros((1, 30, 2)))
    problem = search_problem(model, cost)
    (carried,) = Stationary(width=0.0).carried(problem, model, cost, [plan], futures)
    squash = Squash(problem.middle, problem.half)
    metric = torch.ones(2, dtype=torch.float64)
    policy = KnotPolicy(31, squash, problem.period, metric, width=0.0)
    parameters = {k: torch.from_numpy(p)[None] for k, p in carried.parameters.items()}
    states = carried.imagined.state[0]
    for t in range(30):
        action = policy.action(parameters, torch.from_numpy(states[t])[None])[0].numpy()
        after, _ = tick_once(model, model.weight, states[t], action)
        np.testing.assert_allclose(after, states[t + 1], atol=1e-9)


def test_what_moves_is_not_for_it() -> None:
    model = oscillator()
    cost = oscillator_cost(model, 5)
    cost.rows[2, 0, 0] = 0.1
    with pytest.raises(
        ValueError, match="policy=stationary: expected a reward without a reference"
    ):
        Stationary().actor(search_problem(model, cost), 5)
