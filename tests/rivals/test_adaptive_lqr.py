"""Adaptive control: the model it learns becomes the sim's, its gain the one of who knows it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch

from edtorch.rivals.adaptive_lqr import AdaptiveLqr
from edtorch.rivals.lqr import Lqr
from edtorch.value.linear.lqr import doubled_lqr, finite_horizon_lqr
from sims.linear import LinearSystem
from tests.rivals.problems import pause, problem, scalar, search_for

STATE = [[1.1, 0.3], [-0.2, 0.9]]
ACTION = [[0.0], [0.5]]


@pytest.mark.oracle
def test_learns_the_system_and_its_regulator() -> None:
    sim = LinearSystem(STATE, ACTION, noise=0.005, dt=0.1, time_limit=5.0)
    asked = problem(sim, [1.0, 2.0], [0.3], [0, 1, 2])
    search = AdaptiveLqr(exploration=0.3, piece=15.0, prior=1e6).begin(asked)
    weight = search_for(search, 1)
    eye = torch.eye(2, dtype=torch.float64)
    F = eye + 0.1 * search.model[..., :2]
    torch.testing.assert_close(F, torch.tensor(STATE).double().expand(3, 2, 2), atol=0.02, rtol=0)
    G = 0.1 * search.model[..., 2:]
    torch.testing.assert_close(G, torch.tensor(ACTION).double().expand(3, 2, 1), atol=0.02, rtol=0)
    known = Lqr().begin(asked).parameters["weight"]
    torch.testing.assert_close(weight, known, atol=0.05, rtol=0)
    for account in search.accounts:
        assert account.seconds == pytest.approx(15.0)
        assert (account.episodes, account.failures, account.successes) == (3, 0, 3)


def test_doubling_is_the_recursion() -> None:
    F, G = (torch.tensor(x, dtype=torch.float64) for x in (STATE, ACTION))
    Q, R = torch.eye(2, dtype=torch.float64), torch.eye(1, dtype=torch.float64)
    doubled = doubled_lqr(F[None], G[None], Q, R, doublings=3)[0]
    # The last step of the recursion costs and moves nothing, so that 2^3 steps have as many gains.
    known = finite_horizon_lqr(F, G, Q, R, steps=8)
    torch.testing.assert_close(doubled, known.gains[0])


def test_a_seed_does_the_same_in_any_population() -> None:
    settings = AdaptiveLqr(piece=2.0)
    together = settings.begin(scalar(0.1, seeds=[3, 4]))
    together.advance([True, True], pause)
    together.advance([False, True], pause)
    alone = search_for(settings.begin(scalar(0.1, seeds=[4])), 2)
    assert together.parameters["weight"][1].equal(alone[0])
    assert [a.seconds for a in together.accounts] == [2.0, 4.0]


def test_falls_are_counted_and_survived() -> None:
    """An action that does nothing cannot hold a runaway system: it fails again and again."""
    sim = LinearSystem([[3.0]], [[0.0]], noise=0.01, dt=0.5, time_limit=50.0)
    search = AdaptiveLqr(piece=50.0).begin(problem(sim, [1.0], [1.0], [1, 2]))
    weight = search_for(search, 1)
    assert bool(weight.isfinite().all())
    for account in search.accounts:
        # 3^t > 1000 / |s_0|: 7 ticks or some more each.
        assert 5 <= account.failures == account.episodes <= 100 / 7
        assert account.successes == 0


@pytest.mark.parametrize(
    ("setting", "value", "expected"),
    [
        ("exploration", -1.0, "a number >= 0"),
        ("exploration", math.nan, "a number >= 0"),
        ("doublings", 0, "an integer from 1 to 30"),
        ("piece", 0.0, "a number > 0"),
        ("prior", 0.0, "a number > 0"),
        ("forgetting", 1.5, r"a number in \(0, 1\]"),
    ],
)
def test_refuses(setting: str, value: Any, expected: str) -> None:
    with pytest.raises(ValueError, match=rf"{setting}={value}: expected {expected}"):
        AdaptiveLqr(**{setting: value})


def test_refuses_actions_that_cost_nothing() -> None:
    asked = scalar()
    free = type(asked.weights)(asked.weights.state_cost, 0 * asked.weights.action_cost)
    with pytest.raises(ValueError, match=r"reward\.action: expected a cost > 0 of every action"):
        AdaptiveLqr().begin(dataclasses.replace(asked, reward=free))
