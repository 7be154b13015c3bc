"""The pendulum against Lagrange's equations."""

from __future__ import annotations

import math

import pytest
import torch

from sims.tasks.pendulum_swing_up import PendulumSwingUp
from tests.sims.tasks.mechanics import Rods, check_conservation, check_equations, check_equilibria

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself

RODS = Rods((1.0,), (1.0,), lambda dq, u: u - 0.01 * dq)


@pytest.mark.oracle
def test_mechanics() -> None:
    check_equations(PendulumSwingUp(), RODS)
    check_equilibria(PendulumSwingUp())


@pytest.mark.oracle
def test_energy_is_conserved_without_friction() -> None:
    check_conservation(PendulumSwingUp(), RODS, lambda s: 0.01 * s[:, 1:2])


def test_small_swings_have_the_period_of_a_rod() -> None:
    # sqrt(3 g / 2 l) for a rod hung at its end; friction damps by b / (2 m l^2 / 3) per second.
    frequency, damping = math.sqrt(3 * 9.82 / 2), 0.01 / (2 / 3)
    sim = PendulumSwingUp()
    state = torch.tensor([math.pi + 1e-4, 0.0, 0.0, 1.0, 0.0], dtype=torch.float64)
    for k in range(1, 30):
        state = sim.step(state, torch.zeros(1).double(), torch.zeros(0).double())
        turned = math.sqrt(frequency**2 - damping**2)
        phase = turned * 0.1 * k
        swing = math.exp(-damping * 0.1 * k) * (
            math.cos(phase) + damping / turned * math.sin(phase)
        )
        assert float(state[0]) - math.pi == pytest.approx(1e-4 * swing, abs=1e-9)
