"""PEGASUS climbs the value of its scenarios: it finds the gain that is known to be best."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch

from edtorch.rewards import QuadraticReward
from edtorch.rivals.pegasus import Pegasus
from edtorch.rivals.returns import SparseReward, charge
from edtorch.run.hashing import Use, hash_key, uniform
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.rivals.problems import (
    TICKS,
    best_gain,
    constant,
    expected_rewards,
    pause,
    problem,
    scalar,
    search_for,
)

SMALL = Pegasus(gradients=8, scenarios=10, horizon=100.0, longest=2.0)


@pytest.mark.oracle
def test_finds_the_best_gain() -> None:
    """Without noise the return is s_0^2 times a function of the gain, the same for all starts."""
    search = SMALL.begin(scalar())
    weight = search_for(search, 8)
    best = best_gain(0.0)
    value, most = (float(expected_rewards(constant(g), 0.0, 0.0).sum()) for g in (0.0, best))
    assert value < 2 * most
    for gain in weight.flatten().tolist():
        reached = float(expected_rewards(constant(gain), 0.0, 0.0).sum())
        assert reached == pytest.approx(most, rel=1e-3)
        assert gain == pytest.approx(best, abs=0.03)
    assert search.done == [True, True]


@pytest.mark.oracle
def test_differences_one_way_find_it_too() -> None:
    weight = search_for(dataclasses.replace(SMALL, central=False).begin(scalar()), 8)
    assert float((weight - best_gain(0.0)).abs().max()) < 0.1


@pytest.mark.oracle
def test_the_value_is_the_mean_return_of_the_scenarios() -> None:
    """With noise, over 4,000 scenarios: the expected sum of rewards, to three standard errors."""
    settings = dataclasses.replace(SMALL, scenarios=4000, gradients=1, lengths=1, longest=1e-9)
    search = settings.begin(scalar(noise=0.1, seeds=[5]))
    search.advance([True], pause)
    expected = 0.5 * float(expected_rewards(constant(0.0), 0.1, 0.0).sum())
    assert search.values[0] == pytest.approx(expected, rel=3 / math.sqrt(4000) * 1.0)


def test_the_same_scenarios_for_every_policy() -> None:
    """A policy that is tried twice has the same value: no step of length zero is an improvement."""
    settings = dataclasses.replace(SMALL, lengths=1, longest=1e-300)
    search = settings.begin(scalar(noise=0.1))
    assert bool((search_for(search, 3) == 0).all())
    first = search.values
    search.advance([True, True], pause)
    assert search.values == first


def test_a_seed_does_the_same_in_any_population() -> None:
    together = search_for(SMALL.begin(scalar(0.1, seeds=[3, 4])), 3)
    alone = search_for(SMALL.begin(scalar(0.1, seeds=[4])), 3)
    assert together[1].equal(alone[0])
    assert not together[0].equal(together[1])


@pytest.mark.parametrize("central", [True, False])
def test_every_simulation_is_paid(central: bool) -> None:
    settings = dataclasses.replace(SMALL, scenarios=7, lengths=3, central=central)
    search = settings.begin(scalar())
    search.advance([True, False], pause)
    simulations = 7 * ((2 if central else 1) + 1 + 3)
    assert [a.episodes for a in search.accounts] == [simulations, 0]
    assert search.accounts[0].seconds == pytest.approx(simulations * 0.5 * TICKS)
    assert search.accounts[0].successes == simulations


def test_an_episode_that_is_cut_is_no_ride() -> None:
    settings = dataclasses.replace(SMALL, horizon=2.0)
    search = settings.begin(scalar())
    search.advance([True, True], pause)
    account = search.accounts[0]
    assert account.successes == account.failures == 0
    assert account.seconds == pytest.approx(2.0 * account.episodes)


def test_the_rest_is_charged_after_a_fall() -> None:
    """s' = 3 s fails at the first tick with 3^t |s_0| > 1000, which is known from the starts."""
    sim = LinearSystem([[3.0]], [[0.0]], noise=0.0, dt=0.5, time_limit=100.0)
    asked = problem(sim, [1e-12], [1e-12], [1])
    search = SMALL.begin(asked)
    search.advance([True], pause)
    key = hash_key(Use.SCENARIO, 1, torch.arange(SMALL.scenarios))
    none = torch.zeros(SMALL.scenarios, dtype=torch.int64)
    start = asked.world.initial(uniform(key, none, asked.world.uniforms))[:, 0].abs()
    ticks = ((1000 / start).log() / math.log(3)).ceil()
    expected = float((-20.0 * (100.0 - 0.5 * ticks)).mean())
    # The states themselves cost 1e-12 (1000)^2 per second at most.
    assert search.values[0] == pytest.approx(expected, abs=1e-4)
    assert search.accounts[0].failures == search.accounts[0].episodes


@pytest.mark.parametrize("discount", [1.0, 0.7])
def test_charge_is_an_integral(discount: float) -> None:
    seconds = torch.tensor([0.0, 1.5, 4.0], dtype=torch.float64)
    steps = torch.linspace(0, 4, 400_001, dtype=torch.float64)
    for from_, found in zip(seconds.tolist(), charge(seconds, 4.0, discount).tolist(), strict=True):
        inside = discount ** steps[steps >= from_]
        assert found == pytest.approx(-float(torch.trapezoid(inside, dx=1e-5)), abs=1e-4)


def test_sparse_reward_is_the_reward() -> None:
    generator = torch.Generator().manual_seed(0)
    half = torch.randn(4, 4, generator=generator, dtype=torch.float64)
    half[:, 1] = 0
    costs = half.T @ half, torch.diag(torch.tensor([0.0, 2.0], dtype=torch.float64))
    reward = QuadraticReward(*costs)
    state = torch.randn(9, 4, generator=generator, dtype=torch.float64)
    action = torch.randn(9, 2, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(SparseReward(reward)(state, action), reward(state, action))


@pytest.mark.parametrize(
    ("setting", "value", "expected"),
    [
        ("gradients", 0, "an integer >= 1"),
        ("scenarios", 0, "an integer >= 1"),
        ("lengths", 0, "an integer >= 1"),
        ("difference", 0.0, "a number > 0"),
        ("longest", math.nan, "a number > 0"),
        ("horizon", -1.0, "a number > 0"),
        ("failure_cost", -1.0, "a number >= 0"),
        ("discount", 1.1, r"a number in \(0, 1\]"),
    ],
)
def test_refuses(setting: str, value: Any, expected: str) -> None:
    with pytest.raises(ValueError, match=rf"{setting}={value}: expected {expected}"):
        Pegasus(**{setting: value})


def test_refuses_a_sim_that_cannot_be_run_in_any_order() -> None:
    class Opaque(Bicycle):
        traceable = False

    asked = scalar()
    world = type(asked.world)(Opaque())
    with pytest.raises(ValueError, match="bicycle: expected a domain of tensor functions alone"):
        Pegasus().begin(dataclasses.replace(asked, world=world))
