"""Rewards of what is linear in the lift, and rewards as squares for planners."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.model.lift import Lift
from edtorch.model.told import Told
from edtorch.rewards import LiftedReward, PhysicalReward, QuadraticReward, SaturatingReward
from edtorch.rewards.squares import squares_of
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from tests.systems import normal

SPEC = CartPoleSwingUp().spec
LIFT = Lift.of(Told.of(SPEC))
SCALE = torch.tensor([q.scale for q in SPEC.state]).double()
FORCE = torch.tensor([q.scale for q in SPEC.action]).double()
ROWS = [
    {"weight": 4.0, "position": 1.0, "sin angle": -0.5},
    {"weight": 4.0, "cos angle": 0.5, "constant": -0.5},
]


def _states() -> tuple[Tensor, Tensor]:
    g = torch.Generator().manual_seed(0)
    return 3 * normal(g, 7, 4), 5 * normal(g, 7, 1)


def test_it_is_the_squared_distance_of_the_tip() -> None:
    state, action = _states()
    x, v, angle, rate = state.unbind(-1)
    tip = (x - 0.5 * angle.sin()).square() + (0.5 * angle.cos() - 0.5).square()
    rates = (v / SCALE[1]).square() + (rate / SCALE[3]).square()
    expected = -4 * tip - 0.4 * rates - 0.05 * (action[:, 0] / FORCE[0]).square()
    reward = LiftedReward(SPEC, ROWS, rates=0.4, action=0.05)
    assert torch.allclose(reward(state, action), expected, atol=1e-12)


def test_its_squares_give_it_back_in_scaled_units() -> None:
    state, action = _states()
    reward = LiftedReward(SPEC, ROWS, rates=0.4, action=0.05)
    R, w = squares_of(PhysicalReward(reward, SCALE, FORCE), LIFT, 2)
    assert R.shape == (3, 4, LIFT.size) and (R == R[0]).all()
    lifted = LIFT(state / SCALE, action / FORCE)
    found = -(lifted @ R[0].mT).square().sum(-1) - (w * (action / FORCE).square()).sum(-1)
    assert torch.allclose(found, reward(state, action), atol=1e-12)


def test_squares_of_a_quadratic_reward_agree_near_its_target() -> None:
    target = torch.tensor([0.4, 0.0, 0.3, 0.0]).double()
    Q = torch.diag(torch.tensor([1.0, 0.5, 2.0, 0.0]).double())
    Q[0, 1] = Q[1, 0] = 0.2
    reward = QuadraticReward(Q, torch.tensor([[0.1]]).double(), target=target)
    (R,), w = squares_of(reward, LIFT, 0)
    action = torch.tensor([[0.7]]).double()
    for size in (1e-2, 1e-3):
        state = target + size * torch.tensor([[1.0, -2.0, 1.5, 3.0]]).double()
        found = -(LIFT(state, action) @ R.mT).square().sum(-1) - (w * action.square()).sum(-1)
        # The chord differs from the arc in the fourth order.
        assert torch.allclose(found, reward(state, action), atol=2 * size**4)


def test_an_angle_is_wanted_on_any_turn() -> None:
    target = torch.tensor([0.0, 0.0, 3.0, 0.0]).double()
    Q = torch.diag(torch.tensor([0.0, 0.0, 1.0, 0.0]).double())
    reward = QuadraticReward(Q, torch.eye(1).double(), target=target)
    (R,), _ = squares_of(reward, LIFT, 0)
    turned = target + torch.tensor([0.0, 0.0, 2 * math.pi, 0.0], dtype=torch.float64)
    lifted = LIFT(torch.stack([target, turned]), torch.zeros(2, 1).double())
    assert (lifted @ R.mT).abs().max() < 1e-12


def test_a_row_follows_its_reference() -> None:
    """The squared distance from a moving target; without the time, what does not depend on it."""
    wave = {"amplitude": 0.5, "period": 4.0}
    reward = LiftedReward(SPEC, [{**ROWS[0], "reference": wave}, ROWS[1]], rates=0.4, action=0.05)
    state, action = _states()
    R, _ = squares_of(PhysicalReward(reward, SCALE, FORCE), LIFT, 6)
    tick = torch.arange(7)
    x, v, angle, rate = state.unbind(-1)
    target = 0.5 * torch.sin(math.pi / 2 * SPEC.dt * tick)
    across = 4 * (x - 0.5 * angle.sin() - target).square()
    rest = 4 * (0.5 * angle.cos() - 0.5).square()
    rest = rest + 0.4 * ((v / SCALE[1]).square() + (rate / SCALE[3]).square())
    lifted = LIFT(state / SCALE, action / FORCE)
    found = torch.stack([(R[t] @ lifted[t]).square().sum() for t in range(7)])
    assert torch.allclose(found, across + rest, atol=1e-12)
    assert reward.timed and not LiftedReward(SPEC, ROWS).timed
    assert torch.allclose(
        reward(state, action), -rest - 0.05 * (action[:, 0] / FORCE[0]).square(), atol=1e-12
    )


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "rows="),
        ([{"tip": 1.0}], "tip=1.0: expected one of constant, position"),
        ([{"position": 1.0, "weight": -1.0}], "weight=-1.0"),
        ([{"position": 1.0, "reference": {"amplitude": 1.0}}], r"rows\[0\].reference={'amp"),
        ([{"position": "far"}], r"rows\[0\].position=far: expected a number"),
        ([{"position": 1.0, "reference": []}], r"rows\[0\].reference=\[\]: expected amplitude"),
    ],
)
def test_impossible_rows_are_refused(rows: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LiftedReward(SPEC, rows)


def test_rewards_without_squares_are_refused() -> None:
    with pytest.raises(ValueError, match="SaturatingReward: expected a quadratic reward"):
        squares_of(SaturatingReward(["x"], {"x": 1.0}), LIFT, 0)
