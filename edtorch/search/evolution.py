"""CMA-ES, an evolution strategy with an adapted covariance matrix (Hansen & Ostermeier 2001), by
the package cmaes: where gradients of a cost with events mislead."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from edtorch.errors import NoPlan, Unavailable


class Evolution:
    """A normal distribution of vectors ``[p]`` that moves to where a cost is low.

    It begins about ``middle`` with ``spread`` times the deviations ``[p]``, and draws ``size``
    vectors a generation.  Raises Unavailable without cmaes.
    """

    def __init__(
        self, middle: np.ndarray, deviation: np.ndarray, spread: float, size: int, seed: int
    ) -> None:
        self._middle, self._deviation = middle, deviation
        self._strategy = cmaes_module().CMA(
            mean=np.zeros(len(middle)), sigma=spread, seed=seed, population_size=size
        )

    @property
    def mean(self) -> np.ndarray:
        """Of the distribution, ``[p]``."""
        return self._middle + self._deviation * self._strategy.mean

    def generation(self, cost: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The costs ``[size]`` of a generation, by a cost of vectors ``[C, p] -> [C]``, which may
        be another one each time.

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


def cmaes_module() -> Any:
    """The module cmaes.  Raises Unavailable where it is missing."""
    try:
        return importlib.import_module("cmaes")
    except ImportError as error:
        raise Unavailable(
            f"cmaes cannot be imported ({error}): pip install 'edtorch[population]'"
        ) from error
