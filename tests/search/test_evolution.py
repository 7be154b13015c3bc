"""The evolution strategy: a quadratic's minimum, the same numbers for a seed, broken costs."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from edtorch.errors import NoPlan, Unavailable
from edtorch.search.evolution import Evolution

MIDDLE, DEVIATION = np.array([1.0, -2.0, 0.5]), np.array([1.0, 0.1, 3.0])
BEST = np.array([2.0, -2.1, -3.0])


def bowl(vectors: np.ndarray) -> np.ndarray:
    """Least at ``BEST``, with a ridge."""
    away = (vectors - BEST) / DEVIATION
    return away[:, 0] ** 2 + 10 * (away[:, 1] - away[:, 0]) ** 2 + away[:, 2] ** 2


def evolved(seed: int, cost: Callable[[np.ndarray], np.ndarray] = bowl) -> np.ndarray:
    evolution = Evolution(10).begun(MIDDLE, DEVIATION, 1.0, seed)
    for _ in range(60):
        evolution.improve(cost)
    return evolution.mean


def test_the_minimum_is_found_and_a_seed_repeats() -> None:
    pytest.importorskip("cmaes")
    found = evolved(3)
    assert found == pytest.approx(BEST, abs=1e-3)
    assert np.array_equal(evolved(3), found)
    assert not np.array_equal(evolved(4), found)


def test_costs_that_are_not_finite_are_the_worst() -> None:
    pytest.importorskip("cmaes")

    def broken(vectors: np.ndarray) -> np.ndarray:
        return np.where(vectors[:, 0] > 2.5, np.nan, bowl(vectors))

    assert evolved(3, broken) == pytest.approx(BEST, abs=1e-2)
    costs = Evolution(10).begun(MIDDLE, DEVIATION, 1.0, 3).improve(broken)
    assert costs.shape == (10,) and 0 < np.isnan(costs).sum() < 10
    with pytest.raises(NoPlan, match="none of 10 vectors has a finite cost"):
        evolved(0, lambda x: np.full(len(x), np.inf))


def test_without_cmaes_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(Unavailable, match=r"cmaes cannot be imported .*edtorch\[population\]"):
        evolved(0)
