"""Searches for a vector of which only costs are known."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np

from edtorch.search.package import Package

VectorCost = Callable[[np.ndarray], np.ndarray]
"""Costs ``[C]`` of vectors ``[C, p]``, those of one call under the same conditions."""


class BegunSearch(Protocol):
    """A search that has begun."""

    @property
    def mean(self) -> np.ndarray:
        """The vector that it has reached, ``[p]``."""
        ...

    def improve(self, cost: VectorCost) -> np.ndarray:
        """Try vectors about the mean, move the mean, and return the costs ``[C]`` of the vectors;
        the cost may differ from call to call.  Raises NoPlan where none is finite."""
        ...


class VectorSearch(Protocol):
    """The settings of a search; package: the one that it needs, or None."""

    package: ClassVar[Package | None]

    def begun(
        self, middle: np.ndarray, deviation: np.ndarray, spread: float, seed: int
    ) -> BegunSearch:
        """A search that begins at ``middle`` ``[p]`` and whose first vectors are away from it by
        parts of ``spread`` times ``deviation`` ``[p]``."""
        ...
