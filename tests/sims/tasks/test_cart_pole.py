"""The cart-pole against Lagrange's equations."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.func import grad, hessian, jacrev

from sims.base import Outcome
from sims.rows import TORCH
from sims.tasks.cart_pole import CartPole, derivative_over

CART, POLE, LENGTH, FRICTION, G = 0.5, 0.5, 0.5, 0.1, 9.82


def _lagrangian(q: Tensor, dq: Tensor) -> Tensor:
    """Kinetic minus potential energy of a cart and a uniform rod that leans backwards."""
    angle, rate = q[1], dq[1]
    along = dq[0] - LENGTH / 2 * angle.cos() * rate
    up = -LENGTH / 2 * angle.sin() * rate
    kinetic = CART * dq[0] ** 2 + POLE * (along**2 + up**2) + POLE * LENGTH**2 / 12 * rate**2
    return 0.5 * kinetic - POLE * G * LENGTH / 2 * angle.cos()


@pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself
def test_lagranges_equations() -> None:
    generator = torch.Generator().manual_seed(0)
    for _ in range(5):
        position, speed, angle, rate, force = torch.randn(5, generator=generator).double()
        q, dq = torch.stack([position, angle]), torch.stack([speed, rate])
        mass = hessian(_lagrangian, 1)(q, dq)
        mixed = jacrev(grad(_lagrangian, 1), 0)(q, dq)
        given = torch.stack([force - FRICTION * speed, torch.zeros_like(force)])
        expected = torch.linalg.solve(mass, given + grad(_lagrangian, 0)(q, dq) - mixed @ dq)
        found = torch.stack(derivative_over(TORCH)((position, speed, angle, rate), force))
        torch.testing.assert_close(found[[1, 3]], expected, rtol=1e-10, atol=1e-10)
        assert found[0] == speed and found[2] == rate


def test_steps_converge_with_the_fourth_order_at_least() -> None:
    start = torch.tensor([0.0, 0.5, 0.2, -0.3]).double()
    action, nothing = torch.tensor([4.0]).double(), torch.zeros(0).double()

    def after(ticks: int) -> Tensor:
        sim, state = CartPole(push=1.0, dt=0.4 / ticks), start
        for _ in range(ticks):
            state = sim.step(state, action, nothing)
        return state

    exact = after(64)
    errors = [(after(ticks) - exact).norm().item() for ticks in (4, 8)]
    assert errors[0] / errors[1] > 14


def test_ends() -> None:
    states = torch.tensor([[0.0, 0, 0, 0], [2.5, 0, 0, 0], [0, 0, -0.7, 0]]).double()
    running, failed = int(Outcome.RUNNING), int(Outcome.FAILED)
    assert CartPole().outcome(states).tolist() == [running, failed, failed]
    with pytest.raises(ValueError, match=r"dt=0: expected a number > 0"):
        CartPole(dt=0)
