"""Figures with one value per seed, some of them censored, and what a bootstrap makes of them.

A learner that never succeeded within its budget has no failures *before its first success*, only a
number so far: its value is censored.  Beside what it has paid (``lived``) it counts as worse than
every learner that succeeded: ``ranked`` is infinite there.  So a quartile that no censored learner
reaches is exact, and one that they do reach is infinite, never a number that was not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RESAMPLES = 10_000
SEED = 20_260_101
"""Of the bootstrap: the same runs give the same report, to the last digit."""
MOST_CENSORED = 0.25
"""Above this share the middle half is not known, and only the Kaplan-Meier median is told."""
_AT_ONCE = 1_000
"""Resamples in memory at a time."""


@dataclass(frozen=True)
class Sample:
    """Values ``[n]``, one per seed, and which of them are censored: "at least so much".

    Sorted by value; at equal values the censored ones come last, as is usual.
    """

    lived: Array
    censored: NDArray[np.bool_]

    @staticmethod
    def of(values: list[float], censored: list[bool] | None = None) -> Sample:
        """From values in any order."""
        lived = np.asarray(values, dtype=np.float64)
        marks = np.zeros(len(lived), dtype=bool) if censored is None else np.asarray(censored)
        if not len(lived):
            raise ValueError("values=[]: expected at least one")
        if marks.shape != lived.shape or not np.isfinite(lived).all():
            raise ValueError("values: expected finite numbers, with a mark for each or none at all")
        order = np.lexsort((marks, lived))
        return Sample(lived[order], marks[order].astype(bool))

    def __len__(self) -> int:
        return len(self.lived)

    @property
    def ranked(self) -> Array:
        """Values in rising order, infinite where censored."""
        return np.sort(np.where(self.censored, math.inf, self.lived))

    @property
    def share_censored(self) -> float:
        """From 0 to 1."""
        return float(self.censored.mean())

    @property
    def heavily_censored(self) -> bool:
        """Whether more than ``MOST_CENSORED`` is."""
        return self.share_censored > MOST_CENSORED


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % bootstrap interval; infinite where censored values decide."""

    value: float
    low: float
    high: float

    def as_json(self) -> dict[str, float | None]:
        """null: beyond every budget."""

        def finite(number: float) -> float | None:
            return number if math.isfinite(number) else None

        return {"value": finite(self.value), "low": finite(self.low), "high": finite(self.high)}


@lru_cache(maxsize=4)
def _draws(size: int, stream: int) -> NDArray[np.unsignedinteger]:
    """Places ``[RESAMPLES, size]``, sorted in each row, of a resample in a sorted sample.

    They depend on the size alone, so that all samples of a size share them.  stream: resamples of
    two samples that are compared must not be the same.
    """
    kind = np.uint16 if size <= np.iinfo(np.uint16).max else np.uint32
    random = np.random.default_rng((SEED, stream))
    places = random.integers(size, size=(RESAMPLES, size), dtype=kind)
    places.sort(axis=1)
    return places


def interquartile_mean(values: Array) -> Array:
    """Mean of the middle half ``[...]`` of sorted values ``[..., n]``: a quarter of them, rounded
    down, is left out at each end."""
    cut = values.shape[-1] // 4
    return np.asarray(values[..., cut : values.shape[-1] - cut].mean(-1), dtype=np.float64)


def median(values: Array) -> Array:
    """Of sorted values ``[..., n]``."""
    n = values.shape[-1]
    # Not np.median, for which the mean of two infinities is no number.
    low, high = values[..., (n - 1) // 2], values[..., n // 2]
    return np.where(low == high, low, 0.5 * (low + high))


def percentiles(estimates: Array) -> tuple[float, float]:
    """2.5 and 97.5 %, each a value that occurs: one between two might be half of infinity."""
    low, high = np.quantile(estimates, (0.025, 0.975), method="nearest")
    return float(low), float(high)


def interval(sample: Sample, statistic: Callable[[Array], Array]) -> Interval:
    """Percentile bootstrap (Efron 1979) of a statistic of the sorted, ranked values."""
    values = sample.ranked
    places = _draws(len(sample), 0)
    estimates = np.concatenate([statistic(values[some]) for some in _pieces(places)])
    return Interval(float(statistic(values)), *percentiles(estimates))


def _pieces(places: NDArray[np.unsignedinteger]) -> list[NDArray[np.unsignedinteger]]:
    return [places[k : k + _AT_ONCE] for k in range(0, len(places), _AT_ONCE)]


def survival(sample: Sample, places: NDArray[np.unsignedinteger] | None = None) -> Array:
    """Kaplan-Meier estimate ``[..., n]`` of the share that lasts beyond each value of the sample.

    places ``[..., n]``: of resamples, sorted; else the sample itself.  With n - j at risk at the
    j-th value (counted from 0), each event multiplies by 1 - 1 / (n - j); ties telescope.
    """
    n = len(sample)
    chosen = np.arange(n) if places is None else places
    events = ~sample.censored[chosen]
    lasting: Array = 1.0 - events / (n - np.arange(n, dtype=np.float64))
    return np.cumprod(lasting, axis=-1, dtype=np.float64)


def _crossing(sample: Sample, places: NDArray[np.unsignedinteger] | None) -> Array:
    """Where the survival ``[..., n]`` falls to a half: infinite if it does not; where it rests at
    exactly a half, the middle of the rest, which for no censoring is the median."""
    chosen = np.arange(len(sample)) if places is None else places
    share = survival(sample, places)
    values = sample.lived[chosen]

    def first(below: NDArray[np.bool_]) -> Array:
        at = np.take_along_axis(values, below.argmax(-1)[..., None], -1)[..., 0]
        return np.where(below.any(-1), at, math.inf)

    # The product of up to thousands of factors: a half is one to within rounding.
    reached, passed = first(share < 0.5 + 1e-9), first(share < 0.5 - 1e-9)
    return np.where(reached == passed, reached, 0.5 * (reached + passed))


def kaplan_meier_median(sample: Sample) -> Interval:
    """Kaplan and Meier, JASA 53, 1958, with a percentile bootstrap over the seeds."""
    pieces = _pieces(_draws(len(sample), 0))
    estimates = np.concatenate([_crossing(sample, some) for some in pieces])
    return Interval(float(_crossing(sample, None)), *percentiles(estimates))


def _difference(one: Array, other: Array) -> Array:
    """one - other, where infinity minus infinity is undecided: NaN."""
    with np.errstate(invalid="ignore"):
        return one - other


def difference(sample: Sample, baseline: Sample) -> Interval | None:
    """Of the interquartile means, sample minus baseline; None where too many are censored.

    Stratified: each is resampled on its own, at its own size.
    """
    if sample.heavily_censored or baseline.heavily_censored:
        return None
    ours, theirs = sample.ranked, baseline.ranked
    both = zip(_pieces(_draws(len(sample), 0)), _pieces(_draws(len(baseline), 1)), strict=True)
    estimates = np.concatenate(
        [_difference(interquartile_mean(ours[a]), interquartile_mean(theirs[b])) for a, b in both]
    )
    # A resample in which both are beyond their budgets says nothing of which is further.
    low = np.where(np.isnan(estimates), -math.inf, estimates)
    high = np.where(np.isnan(estimates), math.inf, estimates)
    value = float(interquartile_mean(ours) - interquartile_mean(theirs))
    return Interval(value, percentiles(low)[0], percentiles(high)[1])


def _counts(places: NDArray[np.unsignedinteger], size: int) -> NDArray[np.int64]:
    """How often each place is drawn, ``[R, size]``."""
    rows = np.arange(len(places))[:, None] * size
    return np.bincount((places + rows).ravel(), minlength=len(places) * size).reshape(-1, size)


def probability_less(sample: Sample, baseline: Sample) -> Interval:
    """That a learner of ``sample`` has less than one of ``baseline``, a tie counting a half
    (Mann-Whitney's U over the product of the sizes), with a stratified percentile bootstrap.

    Two censored values are a tie.
    """
    ours, theirs = sample.ranked, baseline.ranked
    below = np.searchsorted(theirs, ours, side="right")
    at_or_below = np.searchsorted(theirs, ours, side="left")
    n, m = len(ours), len(theirs)

    def share(counts: NDArray[np.int64], others: NDArray[np.int64]) -> Array:
        up_to = np.concatenate([np.zeros((len(others), 1), np.int64), others.cumsum(1)], axis=1)
        beaten = m - 0.5 * (up_to[:, below] + up_to[:, at_or_below])
        return (counts * beaten).sum(1) / (n * m)

    both = zip(_pieces(_draws(n, 0)), _pieces(_draws(m, 1)), strict=True)
    estimates = np.concatenate([share(_counts(a, n), _counts(b, m)) for a, b in both])
    once = share(np.ones((1, n), np.int64), np.ones((1, m), np.int64))
    return Interval(float(once[0]), *percentiles(estimates))
