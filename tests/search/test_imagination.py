"""Imagined roll-outs: the plan itself, and what each is made of."""

from __future__ import annotations

import numpy as np
import pytest

from edtorch.search.imagination import Futures, imagine
from edtorch.search.plan import Cost, Plan
from edtorch.search.shooting import Descent, shoot
from edtorch.search.starts import sinusoids
from edtorch.search.tick_model import TickModel
from tests.planning import HANGING, swing_up, swing_up_cost, tick_once


def _planned() -> tuple[TickModel, Cost, Plan]:
    model = swing_up()
    cost = swing_up_cost(model)
    starts = sinusoids(HANGING, 40, 1, model.dt, 1, np.random.default_rng(0))
    (plan,) = shoot(model, cost, starts, Descent(limit=40)).plans
    return model, cost, plan


def test_with_the_true_weights_and_no_noise_it_is_the_plan() -> None:
    model, cost, plan = _planned()
    weight, start = np.tile(model.weight, (2, 1, 1)), np.tile(HANGING, (2, 1))
    imagined = imagine(model, cost, plan, Futures(weight, start, np.zeros((2, 40, 4))))
    assert imagined.finite.all()
    np.testing.assert_array_equal(imagined.state, np.stack([plan.state, plan.state]))
    np.testing.assert_allclose(imagined.cost, plan.cost, rtol=1e-12)


def test_each_has_its_weights_start_and_noise() -> None:
    """By hand: the action follows the reading, with the angle the short way round."""
    model, cost, plan = _planned()
    generator = np.random.default_rng(1)
    weight = model.weight * (1 + 0.1 * generator.standard_normal((3, *model.weight.shape)))
    start = HANGING + 0.1 * generator.standard_normal((3, 4))
    start[1, 2] -= 2 * np.pi
    noise = 0.01 * generator.standard_normal((3, 40, 4))
    imagined = imagine(model, cost, plan, Futures(weight, start, noise))
    for p in range(3):
        state = start[p]
        for t in range(40):
            np.testing.assert_allclose(imagined.state[p, t], state, rtol=1e-6, atol=1e-6)
            away = state + noise[p, t] - plan.state[t]
            away[2] -= 2 * np.pi * np.round(away[2] / (2 * np.pi))
            action = np.tanh(plan.raw[t] + plan.gain[t] @ away)
            state, _ = tick_once(model, weight[p], state, action)


def test_one_that_is_not_finite_is_flagged() -> None:
    model, cost, plan = _planned()
    weight = np.stack([model.weight, np.full_like(model.weight, 1e200)])
    start, noise = np.tile(HANGING, (2, 1)), np.zeros((2, 40, 4))
    imagined = imagine(model, cost, plan, Futures(weight, start, noise))
    assert imagined.finite.tolist() == [True, False] and np.isinf(imagined.cost[1])
    assert np.isfinite(imagined.state[0]).all() and np.isnan(imagined.state[1, -1]).all()


def test_what_does_not_fit_is_named() -> None:
    model, cost, plan = _planned()
    weight, start = np.tile(model.weight, (2, 1, 1)), np.tile(HANGING, (2, 1))
    with pytest.raises(ValueError, match=r"noise: shape \(2, 41, 4\): expected \(2, 40, 4\)"):
        imagine(model, cost, plan, Futures(weight, start, np.zeros((2, 41, 4))))
