"""Adam on gradients by central differences: of a cost whose events make it jump, these are the
slopes of its mean over a width."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch

from edtorch.errors import NoPlan
from edtorch.search.package import Package
from edtorch.search.vector_search import VectorCost


@dataclass(frozen=True)
class CentralDifferences:
    """Adam (Kingma & Ba 2015) in units of the deviations that a search begins with, times its
    spread; width: from the mean to each of the 2 p vectors whose costs a step is made from; rate:
    of a step."""

    width: float = 0.3
    rate: float = 0.3

    package: ClassVar[Package | None] = None

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        for name in ("width", "rate"):
            value = getattr(self, name)
            if not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0")

    def begun(
        self, middle: np.ndarray, deviation: np.ndarray, spread: float, seed: int
    ) -> DifferenceSteps:
        """See ``VectorSearch``; nothing is drawn."""
        return DifferenceSteps(middle, spread * deviation, self.width, self.rate)


class DifferenceSteps:
    """Adam's steps from ``middle`` ``[p]``, in units of ``unit`` ``[p]``."""

    def __init__(self, middle: np.ndarray, unit: np.ndarray, width: float, rate: float) -> None:
        self._middle, self._unit, self._width = middle, unit, width
        self._at = torch.zeros(len(middle)).double()
        self._adam = torch.optim.Adam([self._at], lr=rate)

    @property
    def mean(self) -> np.ndarray:
        """See ``BegunSearch``."""
        return self._middle + self._unit * self._at.numpy()

    def improve(self, cost: VectorCost) -> np.ndarray:
        """A step; see ``BegunSearch``.  Along a direction in which a cost is not finite there is no
        slope."""
        shift = self._width * np.eye(len(self._middle))
        found = cost(self.mean + self._unit * np.concatenate((shift, -shift)))
        if not np.isfinite(found).any():
            raise NoPlan(f"none of {len(found)} vectors has a finite cost")
        ahead, behind = found.reshape(2, -1)
        slope = np.nan_to_num((ahead - behind) / (2 * self._width), posinf=0.0, neginf=0.0)
        self._at.grad = torch.from_numpy(slope)
        self._adam.step()
        return found
