"""The double pendulum against Lagrange's equations."""

from __future__ import annotations

import pytest

from sims.tasks.double_pendulum import DoublePendulum
from tests.sims.tasks.mechanics import Rods, check_conservation, check_equations, check_equilibria

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself

RODS = Rods((0.5, 0.5), (0.5, 0.5), lambda dq, u: u)


@pytest.mark.oracle
def test_mechanics() -> None:
    check_equations(DoublePendulum(), RODS)
    check_equilibria(DoublePendulum())


@pytest.mark.oracle
def test_energy_is_conserved() -> None:
    check_conservation(DoublePendulum(), RODS, lambda s: 0 * s[:, :2])
