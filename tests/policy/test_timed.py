"""Policies that follow a plan, and stationary ones of local linear policies."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.circle import wrapped
from edtorch.policy.knots import KnotPolicy
from edtorch.policy.squash import Squash
from edtorch.policy.timed import TimedPolicy
from tests.systems import normal

SQUASH = Squash(torch.tensor([0.5]).double(), torch.tensor([2.0]).double())
PERIOD = torch.tensor([0.0, 2 * math.pi]).double()
B, H = 3, 5


def _plan(ticks: int = H) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(0)
    return {
        "state": normal(g, B, ticks + 1, 2),
        "raw": normal(g, B, ticks, 1),
        "gain": normal(g, B, ticks, 1, 2),
    }


def test_a_timed_policy_is_the_plan_and_its_gain() -> None:
    plan, policy = _plan(), TimedPolicy(H, SQUASH, PERIOD)
    away = torch.tensor([0.3, -0.2]).double()
    for t in range(H):
        state = plan["state"][:, t] + away
        timed = torch.cat([state, torch.full((B, 1), float(t)).double()], dim=-1)
        raw = plan["raw"][:, t] + plan["gain"][:, t] @ away
        assert torch.allclose(policy.action(plan, timed), 0.5 + 2 * torch.tanh(raw), atol=1e-14)


def test_whole_turns_change_nothing() -> None:
    plan, policy = _plan(), TimedPolicy(H, SQUASH, PERIOD)
    state = torch.cat([plan["state"][:, 2], torch.full((B, 1), 2.0).double()], dim=-1)
    turned = state + torch.tensor([0.0, 4 * math.pi, 0.0])
    assert torch.allclose(policy.action(plan, turned), policy.action(plan, state), atol=1e-12)


def test_the_last_gain_stays_after_the_horizon() -> None:
    plan, policy = _plan(), TimedPolicy(H, SQUASH, PERIOD)
    state = normal(torch.Generator().manual_seed(1), B, 2)
    last, late = (
        torch.cat([state, torch.full((B, 1), float(t)).double()], dim=-1) for t in (H - 1, H + 7)
    )
    assert torch.equal(policy.action(plan, late), policy.action(plan, last))


def test_wrapped_lies_within_half_a_turn() -> None:
    away = torch.tensor([[7.0, 7.0], [-9.0, -9.0]]).double()
    expected = torch.tensor([[7.0, 7 - 2 * math.pi], [-9.0, 2 * math.pi - 9.0]]).double()
    assert torch.allclose(wrapped(away, PERIOD), expected)


def _knots(width: float) -> KnotPolicy:
    return KnotPolicy(H, SQUASH, PERIOD, torch.tensor([1.0, 1.0]).double(), width)


def _parameters() -> dict[str, Tensor]:
    plan = _plan()
    return plan | {"state": plan["state"][:, :H], "factor": torch.ones(B, H).double()}


def test_a_narrow_softmax_takes_the_nearest_knot() -> None:
    state, parameters = normal(torch.Generator().manual_seed(2), B, 2), _parameters()
    nearest = _knots(0.0).action(parameters, state)
    assert torch.allclose(_knots(1e-3).action(parameters, state), nearest, atol=1e-12)


@pytest.mark.parametrize("width", [0.0, 0.5])
def test_a_knot_that_attracts_all_is_its_linear_policy(width: float) -> None:
    state, parameters = normal(torch.Generator().manual_seed(3), B, 2), _parameters()
    parameters["factor"] = torch.full((B, H), 100.0).double()
    parameters["factor"][:, 1] = 0.0
    away = wrapped(state - parameters["state"][:, 1], PERIOD)
    raw = parameters["raw"][:, 1] + (parameters["gain"][:, 1] @ away.unsqueeze(-1)).squeeze(-1)
    assert torch.allclose(_knots(width).action(parameters, state), SQUASH(raw), atol=1e-10)


def test_it_is_linear_in_its_actions_and_gains_before_the_squash() -> None:
    g = torch.Generator().manual_seed(4)
    policy, state, first = _knots(0.5), normal(g, B, 2), _parameters()
    second = first | {"raw": normal(g, B, H, 1), "gain": normal(g, B, H, 1, 2)}
    both = first | {k: first[k] + second[k] for k in ("raw", "gain")}

    def raw(parameters: dict[str, Tensor]) -> Tensor:
        return torch.atanh((policy.action(parameters, state) - 0.5) / 2)

    assert torch.allclose(raw(both), raw(first) + raw(second), atol=1e-6)


def test_impossible_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match="horizon=0"):
        TimedPolicy(0, SQUASH, PERIOD)
    with pytest.raises(ValueError, match="knots=0"):
        KnotPolicy(0, SQUASH, PERIOD, PERIOD)
    with pytest.raises(ValueError, match=r"width=-1\.0"):
        _knots(-1.0)
