"""The cart-double-pendulum against Lagrange's equations."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from sims.tasks.cart_double_pendulum import CartDoublePendulum
from tests.sims.tasks.mechanics import Rods, check_conservation, check_equations, check_equilibria

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself


def _force(dq: Tensor, u: Tensor) -> Tensor:
    nothing = torch.zeros_like(u[0])
    return torch.stack([u[0] - 0.1 * dq[0], nothing, nothing])


RODS = Rods((0.5, 0.5), (0.6, 0.6), _force, cart=0.5)


@pytest.mark.oracle
def test_mechanics() -> None:
    check_equations(CartDoublePendulum(), RODS)
    check_equilibria(CartDoublePendulum())


@pytest.mark.oracle
def test_energy_is_conserved_without_friction() -> None:
    check_conservation(CartDoublePendulum(), RODS, lambda s: 0.1 * s[:, 1:2])
