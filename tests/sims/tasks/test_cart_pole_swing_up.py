"""The cart-pole swing-up against Lagrange's equations, and its moving target."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from tests.sims.tasks.mechanics import Rods, check_conservation, check_equations, check_equilibria

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself

FRICTION = 0.1


def _force(dq: Tensor, u: Tensor) -> Tensor:
    return torch.stack([u[0] - FRICTION * dq[0], torch.zeros_like(dq[0])])


RODS = Rods((0.5,), (0.5,), _force, cart=0.5)


@pytest.mark.oracle
def test_mechanics() -> None:
    check_equations(CartPoleSwingUp(), RODS)
    check_equilibria(CartPoleSwingUp())


@pytest.mark.oracle
def test_energy_is_conserved_without_friction() -> None:
    check_conservation(CartPoleSwingUp(), RODS, lambda s: FRICTION * s[:, 1:2])


def test_the_target_moves() -> None:
    sim = CartPoleSwingUp(amplitude=0.5, period=4.0, time_limit=10.0, hold_from=4.0)
    seconds = torch.linspace(0, 10, 101).double()
    upright = torch.zeros(101, 4).double()
    upright[:, 0] = 0.5 * torch.sin(2 * math.pi * seconds / 4)
    torch.testing.assert_close(sim.target(seconds)[:, 0], upright[:, 0])
    assert sim.target(seconds)[:, 1].tolist() == [0.5] * 101
    torch.testing.assert_close(sim.distance(upright, seconds), torch.zeros(101).double())
    assert bool(sim.judge(upright))
    upright[45, 0] += 0.26
    assert not bool(sim.judge(upright))
    assert not bool(sim.judge(torch.zeros(101, 4).double()))
    aside = torch.tensor([0.3, 0.0, 0.0, 0.0]).double()
    assert float(sim.distance(aside, 1.0)) == pytest.approx(0.2)
