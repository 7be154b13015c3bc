"""CMA-ES, an evolution strategy with an adapted covariance matrix (Hansen & Ostermeier 2001), by
the package cmaes: where gradients of a cost with events mislead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from edtorch.errors import NoPlan
from edtorch.search.package import Package
from edtorch.search.vector_search import VectorCost

CMAES = Package("cmaes", "population")


@dataclass(frozen=True)
class Evolution:
    """Generations of ``size`` vectors."""

    size: int = 16

    package: ClassVar[Package | None] = CMAES

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        if self.size < 2:
            raise ValueError(f"size={self.size}: expected an integer >= 2")

    def begun(
        self, middle: np.ndarray, deviation: np.ndarray, spread: float, seed: int
    ) -> Generations:
        """See ``VectorSearch``.  Raises Unavailable without cmaes."""
        return Generations(middle, deviation, spread, self.size, seed)


class Generations:
    """A normal distribution of vectors ``[p]`` that moves to where a cost is low."""

    def __init__(
        self, middle: np.ndarray, deviation: np.ndarray, spread: float, size: int, seed: int
    ) -> None:
        self._middle, self._deviation = middle, deviation
        self._strategy = CMAES.module().CMA(
            mean=np.zeros(len(middle)), sigma=spread, seed=seed, population_size=size
        )

    @property
    def mean(self) -> np.ndarray:
        """Of the distribution, ``[p]``."""
        return self._middle + self._deviation * self._strategy.mean

    def improve(self, cost: VectorCost) -> np.ndarray:
        """A generation; see ``BegunSearch``.

        A cost that is not finite counts as the worst of its generation.  Raises NoPlan where none
        is finite.
        """
        drawn = np.array([self._strategy.ask() for _ in range(self._strategy.population_size)])
        found = cost(self._middle + self._deviation * drawn)
        finite = np.isfinite(found)
        if not finite.any():
            raise NoPlan(f"none of {len(found)} vectors has a finite cost")
        ranked = np.where(finite, found, found[finite].max())
        self._strategy.tell(list(zip(drawn, ranked.tolist(), strict=True)))
        return found
