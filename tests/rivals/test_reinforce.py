"""REINFORCE: its gradient is that of the expected reward, and it climbs to the best gain."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from edtorch.rivals.reinforce import Reinforce
from sims.linear import LinearSystem
from tests.rivals.problems import (
    TICKS,
    best_gain,
    expected_rewards,
    pause,
    problem,
    scalar,
    search_for,
)

SIGMA, DISCOUNT, DT = 0.5, 0.6, 0.5


def _gradient(gain: float, noise: float) -> float:
    """sum_t sum_{k >= t} gamma^(k - t) d E r_k / d theta_t, theta_t being the gain of tick t."""
    gains = torch.full((TICKS,), gain, dtype=torch.float64, requires_grad=True)
    rewards = expected_rewards(gains, noise, SIGMA)
    total = 0.0
    for k in range(TICKS):
        (slope,) = torch.autograd.grad(rewards[k], gains, retain_graph=True)
        ages = k - torch.arange(TICKS, dtype=torch.float64)
        weights = torch.where(ages >= 0, (DISCOUNT**DT) ** ages.clamp(min=0), 0.0)
        total += DT * float((weights * slope).sum())
    return total


@pytest.mark.oracle
def test_the_gradient_is_that_of_the_expected_reward() -> None:
    """The mean over 40 batches, with a baseline and without: to four standard errors."""
    problem = scalar(noise=0.1, seeds=range(40))
    settings = Reinforce(batch=200, deviation=SIGMA, discount=DISCOUNT, horizon=100.0)
    search = settings.begin(problem)
    rows = list(range(40))
    expected = _gradient(0.0, 0.1)
    spreads = []
    for _ in range(2):
        found = search.gradient(rows, pause).flatten()
        spreads.append(float(found.std()))
        assert float(found.mean()) == pytest.approx(expected, abs=4 * spreads[-1] / math.sqrt(40))
    # The first batch knows no baseline.
    assert spreads[1] < 0.8 * spreads[0]


@pytest.mark.oracle
def test_finds_the_best_gain() -> None:
    settings = Reinforce(
        batch=200, updates=10, deviation=0.3, alpha=0.3, beta=1.0, horizon=100.0, discount=0.99
    )
    weight = search_for(settings.begin(scalar(noise=0.1)), 4)
    assert float((weight - best_gain(0.1)).abs().max()) < 0.15


@pytest.mark.oracle
def test_a_failure_costs() -> None:
    """One tick that fails where |a| > 1: with the zero policy that is of known probability, and the
    baseline learns what it costs, from whatever start."""
    sim = LinearSystem([[0.0]], [[1000.0]], noise=0.0, dt=1.0, time_limit=1.0)
    settings = Reinforce(batch=10_000, updates=1, deviation=0.5, discount=0.9)
    search = settings.begin(problem(sim, [1e-12], [1e-12], [0]))
    search.gradient([0], pause)
    share = math.erfc(1 / 0.5 / math.sqrt(2))
    account = search.accounts[0]
    assert account.failures / account.episodes == pytest.approx(share, abs=0.01)
    cost = 20.0 * 0.9 / -math.log(0.9)
    # Four standard errors of the weight of s^2, whose standard deviation is .3.
    error = 4 * cost * math.sqrt(share / 10_000) / 0.3
    expected = torch.tensor([-cost * share, 0.0], dtype=torch.float64)
    torch.testing.assert_close(search.baseline[0], expected, atol=error, rtol=0)


def test_a_seed_does_the_same_in_any_population() -> None:
    settings = Reinforce(batch=20, updates=3)
    together = search_for(settings.begin(scalar(0.1, seeds=[3, 4])), 2)
    alone = search_for(settings.begin(scalar(0.1, seeds=[4])), 2)
    assert together[1].equal(alone[0])
    assert not together[0].equal(together[1])


def test_what_is_paid() -> None:
    search = Reinforce(batch=5, updates=3, horizon=2.0).begin(scalar())
    search.advance([False, True], pause)
    idle, busy = search.accounts
    assert (idle.episodes, busy.episodes) == (0, 15)
    assert busy.seconds == pytest.approx(15 * 2.0)
    assert busy.failures == busy.successes == 0
    assert bool((search.parameters["weight"][0] == 0).all())


@pytest.mark.parametrize(
    ("setting", "value", "expected"),
    [
        ("batch", 0, "an integer >= 1"),
        ("updates", 0, "an integer >= 1"),
        ("deviation", 0.0, "a number > 0"),
        ("alpha", math.nan, "a number > 0"),
        ("horizon", 0.0, "a number > 0"),
        ("beta", -1.0, "a number >= 0"),
        ("failure_cost", -1.0, "a number >= 0"),
        ("discount", 1.0, r"a number between 0 and 1 \(per second\)"),
    ],
)
def test_refuses(setting: str, value: Any, expected: str) -> None:
    with pytest.raises(ValueError, match=rf"{setting}={value}: expected {expected}"):
        Reinforce(**{setting: value})
