"""The pendubot against Lagrange's equations."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from sims.tasks.pendubot import Pendubot
from tests.sims.tasks.mechanics import Rods, check_conservation, check_equations, check_equilibria

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself


def _force(dq: Tensor, u: Tensor) -> Tensor:
    return torch.stack([u[0], torch.zeros_like(u[0])])


RODS = Rods((0.5, 0.5), (0.5, 0.5), _force)


@pytest.mark.oracle
def test_mechanics() -> None:
    check_equations(Pendubot(), RODS)
    check_equilibria(Pendubot())


@pytest.mark.oracle
def test_energy_is_conserved() -> None:
    check_conservation(Pendubot(), RODS, lambda s: 0 * s[:, :1])
