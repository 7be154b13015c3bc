"""Adam on central differences: a quadratic's slope and minimum, jumps, infinite costs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from edtorch.errors import NoPlan
from edtorch.search.differences import CentralDifferences
from tests.search.test_evolution import BEST, DEVIATION, MIDDLE, bowl


def test_a_step_is_adam_s_along_the_exact_slope_of_a_quadratic() -> None:
    """Central differences of a quadratic are exact at any width; the rest is torch's Adam."""
    spread, rate = 0.5, 0.2
    begun = CentralDifferences(width=0.7, rate=rate).begun(MIDDLE, DEVIATION, spread, 0)
    own = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([own], lr=rate)
    for _ in range(5):
        away = torch.from_numpy((MIDDLE - BEST) / DEVIATION) + spread * own
        cost = away[0] ** 2 + 10 * (away[1] - away[0]) ** 2 + away[2] ** 2
        adam.zero_grad()
        cost.backward()
        adam.step()
        assert begun.improve(bowl).shape == (6,)
        expected = MIDDLE + spread * DEVIATION * own.detach().numpy()
        assert begun.mean == pytest.approx(expected, rel=1e-9)


def test_the_minimum_is_found() -> None:
    begun = CentralDifferences(rate=0.1).begun(MIDDLE, DEVIATION, 1.0, 0)
    for _ in range(600):
        begun.improve(bowl)
    assert begun.mean == pytest.approx(BEST, abs=0.02)


def test_a_jump_within_the_width_has_a_slope_and_none_beyond() -> None:
    def fallen(vectors: np.ndarray) -> np.ndarray:
        return np.where(vectors[:, 0] > 1.2, 0.0, 1.0)

    for width, moved in ((0.3, 0.1), (0.1, 0.0)):
        begun = CentralDifferences(width, rate=0.1).begun(MIDDLE, np.ones(3), 1.0, 0)
        begun.improve(fallen)
        assert begun.mean - MIDDLE == pytest.approx([moved, 0.0, 0.0], abs=1e-6)


def test_costs_that_are_not_finite_give_no_slope() -> None:
    def broken(vectors: np.ndarray) -> np.ndarray:
        return np.where(vectors[:, 1] > MIDDLE[1], np.nan, -vectors[:, 0])

    begun = CentralDifferences(rate=0.1).begun(MIDDLE, DEVIATION, 1.0, 0)
    assert np.isnan(begun.improve(broken)).sum() == 1
    assert begun.mean - MIDDLE == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)
    with pytest.raises(NoPlan, match="none of 6 vectors has a finite cost"):
        begun.improve(lambda x: np.full(len(x), np.inf))


@pytest.mark.parametrize("name", ["width", "rate"])
def test_invalid_settings_are_rejected(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}=0"):
        CentralDifferences(**{name: 0.0})
