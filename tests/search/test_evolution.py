"""The evolution strategy: a quadratic's minimum, the same numbers for a seed, broken costs."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from edtorch.errors import NoPlan, Unavailable
from edtorch.search.evolution import evolve

MIDDLE, DEVIATION = np.array([1.0, -2.0, 0.5]), np.array([1.0, 0.1, 3.0])
BEST = np.array([2.0, -2.1, -3.0])


def bowl(vectors: np.ndarray) -> np.ndarray:
    """Least at ``BEST``, with a ridge."""
    away = (vectors - BEST) / DEVIATION
    return away[:, 0] ** 2 + 10 * (away[:, 1] - away[:, 0]) ** 2 + away[:, 2] ** 2


def test_the_minimum_is_found_and_a_seed_repeats() -> None:
    pytest.importorskip("cmaes")
    found = evolve(bowl, MIDDLE, DEVIATION, 1.0, 60, 10, 3)
    assert found.vector == pytest.approx(BEST, abs=1e-3) and found.cost < 1e-6
    assert (found.tried, found.dropped) == (600, 0)
    again = evolve(bowl, MIDDLE, DEVIATION, 1.0, 60, 10, 3)
    assert np.array_equal(again.vector, found.vector)
    other = evolve(bowl, MIDDLE, DEVIATION, 1.0, 60, 10, 4)
    assert not np.array_equal(other.vector, found.vector)


def test_costs_that_are_not_finite_are_dropped() -> None:
    pytest.importorskip("cmaes")

    def broken(vectors: np.ndarray) -> np.ndarray:
        return np.where(vectors[:, 0] > 2.5, np.nan, bowl(vectors))

    found = evolve(broken, MIDDLE, DEVIATION, 1.0, 60, 10, 3)
    assert found.cost < 1e-4 and found.dropped > 0
    with pytest.raises(NoPlan, match="none of 20 vectors has a finite cost"):
        evolve(lambda x: np.full(len(x), np.inf), MIDDLE, DEVIATION, 1.0, 2, 10, 0)


def test_without_cmaes_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(Unavailable, match=r"cmaes cannot be imported .*edtorch\[population\]"):
        evolve(bowl, MIDDLE, DEVIATION, 1.0, 1, 10, 0)
