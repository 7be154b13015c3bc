"""Mean starts on the circle, and wanted states."""

from __future__ import annotations

import math

import pytest
import torch

from edtorch.model.families import ImplicitModel
from edtorch.model.mechanism import Structure
from edtorch.model.told import Told
from edtorch.rewards import LiftedReward
from edtorch.search.target import distances, mean_start, wanted_states
from sims.base import Spec
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from sims.tasks.pendubot import Pendubot


def test_angles_are_averaged_on_the_circle() -> None:
    period = torch.tensor([0.0, 2 * math.pi]).double()
    starts = torch.tensor([[1.0, 3.1], [2.0, -3.1], [3.0, 3.1 + 2 * math.pi]]).double()
    expected = torch.tensor([2.0, 3.1 + (2 * math.pi - 6.2) / 3]).double()
    assert torch.allclose(mean_start(starts, period), expected)


def _structure(spec: Spec) -> Structure:
    (structure,) = ImplicitModel().structures(Told.of(spec)).values()
    return structure


def test_the_state_that_the_tip_wants_is_upright() -> None:
    spec = CartPoleSwingUp().spec
    rows = [{"position": 1.0, "sin angle": -0.5}, {"cos angle": 0.5, "constant": -0.5}]
    R, _ = LiftedReward(spec, rows, rates=0.4).lifted_squares(3)
    found = wanted_states(_structure(spec), R.numpy(), 0.1)
    assert found.shape == (4, 4) and found.abs().max() < 1e-4


def test_distances_are_of_what_counts_the_short_way_round() -> None:
    spec = CartPoleSwingUp().spec
    structure = _structure(spec)
    R, _ = LiftedReward(spec, [{"sin angle": 1.0}], rates=0.0).lifted_squares(1)
    period = float(structure.period[2])
    state, goal = torch.tensor([[1.0, 2.0, 0.9, 3.0], [0.0, 0.0, 0.1, 0.0]]).double() * period
    assert distances(structure, R[0].numpy(), state, goal) == [(2, pytest.approx(0.2 * period))]


def test_what_moves_is_wanted_with_its_rate() -> None:
    """A tip on a slow wave: the cart follows it upright, at the speed of the wave."""
    spec = CartPoleSwingUp().spec
    wave = {"amplitude": 0.5, "period": 40.0}
    rows = [
        {"position": 1.0, "sin angle": -0.5, "reference": wave},
        {"cos angle": 0.5, "constant": -0.5},
    ]
    R, _ = LiftedReward(spec, rows).lifted_squares(400)
    found = wanted_states(_structure(spec), R.numpy(), 0.1)
    phase = 2 * math.pi / 400 * torch.arange(401).double()
    assert torch.allclose(found[:, 0], 0.5 * phase.sin(), atol=2e-4)
    speed = 0.5 * 2 * math.pi / 40 * phase.cos() / spec.state[1].scale
    assert torch.allclose(found[1:-1, 1], speed[1:-1], atol=1e-3)
    assert found[:, 2:].abs().max() < 1e-2


def test_a_place_is_reached_by_two_angles() -> None:
    spec = Pendubot().spec
    names = [q.name for q in spec.state if q.period]
    x = {f"sin {name}": -0.5 for name in names} | {"constant": 0.5}
    y = {f"cos {name}": 0.5 for name in names} | {"constant": -0.5}
    structure = _structure(spec)
    R, _ = LiftedReward(spec, [x, y], rates=0.4).lifted_squares(0)
    (found,) = wanted_states(structure, R.numpy(), 0.1)
    lifted = structure.lift(found, torch.zeros(len(spec.action)).double())
    assert (lifted @ R[0].mT).abs().max() < 1e-4
