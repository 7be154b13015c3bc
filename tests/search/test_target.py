"""Mean starts on the circle, and wanted states."""

from __future__ import annotations

import math

import torch

from edtorch.model.lift import Lift
from edtorch.model.told import Told
from edtorch.rewards import LiftedReward
from edtorch.search.target import mean_start, wanted_state
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from sims.tasks.pendubot import Pendubot


def test_angles_are_averaged_on_the_circle() -> None:
    period = torch.tensor([0.0, 2 * math.pi]).double()
    starts = torch.tensor([[1.0, 3.1], [2.0, -3.1], [3.0, 3.1 + 2 * math.pi]]).double()
    expected = torch.tensor([2.0, 3.1 + (2 * math.pi - 6.2) / 3]).double()
    assert torch.allclose(mean_start(starts, period), expected)


def test_the_state_that_the_tip_wants_is_upright() -> None:
    spec = CartPoleSwingUp().spec
    rows = [{"position": 1.0, "sin angle": -0.5}, {"cos angle": 0.5, "constant": -0.5}]
    R, _ = LiftedReward(spec, rows, rates=0.4).lifted_squares
    found = wanted_state(Lift.of(Told.of(spec)), R.numpy())
    assert found.abs().max() < 1e-4


def test_a_place_is_reached_by_two_angles() -> None:
    spec = Pendubot().spec
    names = [q.name for q in spec.state if q.period]
    x = {f"sin {name}": -0.5 for name in names} | {"constant": 0.5}
    y = {f"cos {name}": 0.5 for name in names} | {"constant": -0.5}
    lift = Lift.of(Told.of(spec))
    R, _ = LiftedReward(spec, [x, y], rates=0.4).lifted_squares
    found = wanted_state(lift, R.numpy())
    lifted = lift(found, torch.zeros(len(spec.action)).double())
    assert (lifted @ R.mT).abs().max() < 1e-4
