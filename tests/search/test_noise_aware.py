"""Gains that weigh the noise of the sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edtorch.search.imagination import Futures, imagine
from edtorch.search.noise_aware import noise_aware_gains
from edtorch.search.plan import Plan
from edtorch.search.shooting import Descent, shoot
from edtorch.search.starts import sinusoids, still
from tests.planning import HANGING, oscillator, oscillator_cost, swing_up, swing_up_cost


def test_without_noise_they_are_the_plans() -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    starts = sinusoids(HANGING, 40, 1, model.dt, 1, np.random.default_rng(0))
    (plan,) = shoot(model, cost, starts, Descent(limit=30)).plans
    for start in (np.zeros((4, 4)), 0.01 * np.eye(4)):
        same = noise_aware_gains(model, cost, plan, start, np.zeros((4, 4)))
        np.testing.assert_allclose(same.gain, plan.gain, rtol=1e-4, atol=1e-6)
        assert (same.state == plan.state).all() and same.cost == plan.cost


@pytest.mark.parametrize("push", [(1.0,), (1.0, -0.4, 0.2)])
def test_on_a_linear_system_they_cost_less(push: tuple[float, ...]) -> None:
    """The expected cost by Monte Carlo, the same draws for both."""
    model, nothing = oscillator(push), np.zeros((30, len(push)))
    cost = oscillator_cost(model)
    exact = Descent(damping=1e-6)
    (plan,) = shoot(model, cost, [still(np.array([0.4, -0.2]), nothing)], exact).plans
    start, noise = np.diag([0.04, 0.01]), np.diag([0.09, 0.5])
    aware = noise_aware_gains(model, cost, plan, start, noise, damping=1e-6)
    generator = np.random.default_rng(0)
    first = plan.state[0] + generator.standard_normal((500, 2)) @ np.sqrt(start)
    read = generator.standard_normal((500, 30, 2)) @ np.sqrt(noise)
    weight = np.tile(model.weight, (500, 1, 1))

    def paid(which: Plan) -> np.ndarray:
        return imagine(model, cost, which, Futures(weight, first, read)).cost

    saved = paid(plan) - paid(aware)
    assert saved.mean() > 5 * saved.std() / np.sqrt(500)
    # And they are at a minimum: no other scale of them is better.
    for factor in (0.8, 1.25):
        assert paid(replace(aware, gain=factor * aware.gain)).mean() > paid(aware).mean()


def test_noise_shrinks_the_gains() -> None:
    model = swing_up()
    cost = swing_up_cost(model)
    starts = sinusoids(HANGING, 40, 1, model.dt, 1, np.random.default_rng(0))
    (plan,) = shoot(model, cost, starts, Descent(limit=30)).plans
    sizes = [
        np.linalg.norm(noise_aware_gains(model, cost, plan, 0.01 * np.eye(4), r * np.eye(4)).gain)
        for r in (1e-8, 1e-4, 1e-2, 1.0)
    ]
    assert sizes == sorted(sizes, reverse=True) and sizes[-1] < 0.7 * sizes[0]


def test_what_does_not_fit_is_named() -> None:
    model = oscillator()
    cost = oscillator_cost(model)
    plan = still(np.zeros(2), np.zeros((30, 1)))
    with pytest.raises(ValueError, match=r"noise: shape \(2,\): expected \(2, 2\), a covariance"):
        noise_aware_gains(model, cost, plan, np.eye(2), np.ones(2))
