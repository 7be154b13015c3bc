"""Searches for a vector of which only costs are known."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np

from edtorch.search.package import Package

VectorCost = Callable[[np.ndarray], np.ndarray]
"""Costs ``[C]`` of vectors ``[C, p]``, those of one call under the same conditions."""


class BegunSearch(Protocol):
    """A search on its way."""

    @property
    def mean(self) -> np.ndarray:
        """Where it is, ``[p]``."""
        ...

    def improve(self, cost: VectorCost) -> np.ndarray:
        """Go on by vectors about the mean, and return their costs ``[C]``; the cost may be another
        one each time.  Raises NoPlan where none is finite."""
        ...


class VectorSearch(Protocol):
    """Its settings; package: that it needs, None for none."""

    package: ClassVar[Package | None]

    def begun(
        self, middle: np.ndarray, deviation: np.ndarray, spread: float, seed: int
    ) -> BegunSearch:
        """A search that begins at ``middle`` ``[p]`` and whose first vectors are away from it by
        parts of ``spread`` times ``deviation`` ``[p]``."""
        ...
