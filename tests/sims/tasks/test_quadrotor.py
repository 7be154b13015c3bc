"""The quadrotor: rigid-body mechanics, conserved quantities, ends."""

from __future__ import annotations

import math

import pytest
import torch

from sims.base import Outcome
from sims.rows import TORCH, stacked, unstacked
from sims.tasks.quadrotor import GRAVITY, INERTIA, Quadrotor, derivative_over

NOTHING = torch.zeros(0).double()


def test_it_hovers_with_its_weight_as_thrust() -> None:
    sim = Quadrotor()
    state, action = torch.zeros(12).double(), torch.tensor([GRAVITY, 0, 0, 0], dtype=torch.float64)
    for _ in range(100):
        state = sim.step(state, action, NOTHING)
    assert state.abs().max() < 1e-12


def test_without_thrust_it_falls() -> None:
    sim, state = Quadrotor(), torch.zeros(12).double()
    for _ in range(25):
        state = sim.step(state, torch.zeros(4).double(), NOTHING)
    assert state[2].item() == pytest.approx(-0.5 * GRAVITY * 0.25)
    assert state[5].item() == pytest.approx(-0.5 * GRAVITY)


def test_without_torques_momentum_and_energy_of_rotation_are_conserved() -> None:
    """In the inertial frame the angular momentum R I w stays the same."""
    inertia = torch.tensor(INERTIA).double()

    def rotation(angles: torch.Tensor) -> torch.Tensor:
        (sr, sp, sy), (cr, cp, cy) = angles.sin(), angles.cos()
        rows = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        return torch.stack([torch.stack(row) for row in rows])

    sim, state = Quadrotor(dt=0.01), torch.zeros(12).double()
    state[6:] = torch.tensor([0.2, -0.1, 0.3, 1.0, -0.7, 0.5])
    before = rotation(state[6:9]) @ (inertia * state[9:])
    energy = (inertia * state[9:].square()).sum()
    for _ in range(50):
        state = sim.step(state, torch.zeros(4).double(), NOTHING)
    after = rotation(state[6:9]) @ (inertia * state[9:])
    torch.testing.assert_close(after, before, rtol=1e-6, atol=1e-10)
    torch.testing.assert_close((inertia * state[9:].square()).sum(), energy, rtol=1e-8, atol=0.0)


def test_thrust_pushes_along_the_bodys_axis() -> None:
    state = torch.zeros(3, 12).double()
    state[1, 6] = state[2, 7] = math.pi / 6
    action = torch.tensor([10.0, 0, 0, 0]).double().expand(3, 4)
    moved = stacked(derivative_over(TORCH)(unstacked(state), unstacked(action)), state)
    push = moved[:, 3:6] + torch.tensor([0, 0, GRAVITY])
    expected = [[0, 0, 10], [0, -5, 10 * math.cos(math.pi / 6)], [5, 0, 10 * math.cos(math.pi / 6)]]
    torch.testing.assert_close(push, torch.tensor(expected).double())


def test_ends() -> None:
    states = torch.zeros(4, 12).double()
    states[1, 2], states[2, 6], states[3, 8] = -2.1, 1.1, 3.0
    failed = [bool(v == int(Outcome.FAILED)) for v in Quadrotor().outcome(states)]
    assert failed == [False, True, True, False]
    with pytest.raises(ValueError, match=r"most_thrust=1\.0: expected a number > 1"):
        Quadrotor(most_thrust=1.0)
