"""A minimum by an evolution strategy with an adapted covariance matrix (CMA-ES; Hansen & Ostermeier
2001), by the package cmaes: where gradients of a cost with events mislead."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edtorch.errors import NoPlan, Unavailable


@dataclass(frozen=True)
class Evolved:
    """vector ``[p]``: the best one that was tried; cost: its cost; tried: how many were; dropped:
    those whose cost was not finite."""

    vector: np.ndarray
    cost: float
    tried: int
    dropped: int


def evolve(
    cost: Callable[[np.ndarray], np.ndarray],
    middle: np.ndarray,
    deviation: np.ndarray,
    spread: float,
    generations: int,
    size: int,
    seed: int,
) -> Evolved:
    """The least ``cost`` of vectors ``[C, p] -> [C]`` from ``generations`` of ``size`` vectors
    each, the first normal about ``middle`` with ``spread`` times the deviations ``[p]``.

    A cost that is not finite counts as the worst of its generation.  Raises Unavailable without
    cmaes, and NoPlan where no cost is finite.
    """
    strategy = cmaes_module().CMA(
        mean=np.zeros(len(middle)), sigma=spread, seed=seed, population_size=size
    )
    best, least, dropped = middle, np.inf, 0
    for _ in range(generations):
        drawn = np.array([strategy.ask() for _ in range(size)])
        vectors = middle + deviation * drawn
        found = cost(vectors)
        finite = np.isfinite(found)
        dropped += int(size - finite.sum())
        if finite.any():
            found = np.where(finite, found, found[finite].max())
            first = int(found.argmin())
            if found[first] < least:
                best, least = vectors[first], float(found[first])
        else:
            found = np.zeros(size)
        strategy.tell(list(zip(drawn, found.tolist(), strict=True)))
    tried = generations * size
    if not np.isfinite(least):
        raise NoPlan(f"none of {tried} vectors has a finite cost")
    return Evolved(best, least, tried, dropped)


def cmaes_module() -> Any:
    """The module cmaes.  Raises Unavailable where it is missing."""
    try:
        return importlib.import_module("cmaes")
    except ImportError as error:
        raise Unavailable(
            f"cmaes cannot be imported ({error}): pip install 'edtorch[population]'"
        ) from error
