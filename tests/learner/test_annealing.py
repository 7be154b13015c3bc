"""Settings that change with age."""

from __future__ import annotations

import math

import pytest
import torch

from edtorch.learner.annealing import Annealed


def test_falls_from_start_to_final_by_e_in_every_decay() -> None:
    ages = torch.tensor([0, 30, 60, 10**9])
    found = Annealed(1.0, 0.2, 30.0)(ages, torch.float64)
    wanted = [1.0, 0.2 + 0.8 / math.e, 0.2 + 0.8 / math.e**2, 0.2]
    assert found.tolist() == pytest.approx(wanted, rel=1e-12)
    assert Annealed(1.0, 0.2, 30.0)(ages, torch.float32).dtype == torch.float32


@pytest.mark.parametrize("decay", [0.0, -1.0, math.nan])
def test_refuses_a_decay_that_is_none(decay: float) -> None:
    with pytest.raises(ValueError, match=r"decay=.*expected a number > 0"):
        Annealed(1.0, 0.2, decay)
