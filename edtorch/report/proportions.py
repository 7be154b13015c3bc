"""Figures of shares: how many of so many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any


@dataclass(frozen=True)
class Proportion:
    """``count`` of ``total``."""

    count: int
    total: int

    def __post_init__(self) -> None:
        """Refuse what is no share."""
        if self.total < 1:
            raise ValueError(f"total={self.total}: expected an integer >= 1")
        if not 0 <= self.count <= self.total:
            raise ValueError(f"count={self.count}: expected an integer in [0, {self.total}]")

    @property
    def rate(self) -> float:
        """The share."""
        return self.count / self.total

    def wilson(self, confidence: float = 0.95) -> tuple[float, float]:
        """The score interval of E. B. Wilson, "Probable inference", JASA 22, 1927."""
        z = NormalDist().inv_cdf((1 + confidence) / 2)
        n, p = self.total, self.rate
        middle = p + z * z / (2 * n)
        reach = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        scale = 1 + z * z / n
        return max(0.0, (middle - reach) / scale), min(1.0, (middle + reach) / scale)

    def as_json(self) -> dict[str, Any]:
        """``count``, ``total``, ``rate`` and its Wilson 95 % interval, ``low`` and ``high``."""
        low, high = self.wilson()
        return {
            "count": self.count,
            "total": self.total,
            "rate": self.rate,
            "low": low,
            "high": high,
        }


def same_rate(one: Proportion, other: Proportion) -> float:
    """p of the two-sided two-proportion z test (pooled) that both are draws of one rate."""
    pooled = (one.count + other.count) / (one.total + other.total)
    deviation = math.sqrt(pooled * (1 - pooled) * (1 / one.total + 1 / other.total))
    if deviation == 0:
        return 1.0
    return 2 * NormalDist().cdf(-abs(one.rate - other.rate) / deviation)


def holm(p: Sequence[float]) -> list[float]:
    """p of several tests, each adjusted so that none is below the chance of any false alarm.

    The step-down procedure of S. Holm, "A simple sequentially rejective multiple test procedure",
    Scandinavian Journal of Statistics 6, 1979: with m tests the k-th smallest p (from 0) times
    m - k, no less than any before it, 1 at most.  Raises ValueError for what is no probability.
    """
    for value in p:
        if not 0 <= value <= 1:
            raise ValueError(f"p={value}: expected a probability")
    adjusted = [1.0] * len(p)
    least = 0.0
    for rank, place in enumerate(sorted(range(len(p)), key=p.__getitem__)):
        least = max(least, min(1.0, (len(p) - rank) * p[place]))
        adjusted[place] = least
    return adjusted
