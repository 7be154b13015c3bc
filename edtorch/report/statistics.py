"""Figures of a run over its seeds; the seed is the unit, however many episodes it had."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.report.domain import RETURN
from edtorch.run.episodes import Episode
from edtorch.run.milestones import FirstSuccess
from sims.base import Measure, Outcome, Words


@dataclass(frozen=True)
class Spread:
    """One figure per seed (None: this seed has none), with its median and extremes."""

    per_seed: list[float | None]

    @property
    def known(self) -> list[float]:
        """The figures that there are."""
        return _finite(self.per_seed)

    @property
    def median(self) -> float | None:
        """Median over the seeds that have the figure."""
        return _median(self.known)

    def as_json(self) -> dict[str, Any]:
        """``per_seed``, ``median``, ``min``, ``max``; null where there is none."""
        known = self.known
        return {
            "per_seed": [v if v is not None and math.isfinite(v) else None for v in self.per_seed],
            "median": self.median,
            "min": min(known) if known else None,
            "max": max(known) if known else None,
        }


def _finite(values: Sequence[float | None]) -> list[float]:
    return [v for v in values if v is not None and math.isfinite(v)]


def _median(values: Sequence[float]) -> float | None:
    numbers = _finite(values)
    return statistics.median(numbers) if numbers else None


def _mean(values: Sequence[float]) -> float | None:
    numbers = _finite(values)
    return statistics.fmean(numbers) if numbers else None


def _share(marks: Sequence[bool | None]) -> float | None:
    """Of those that are known; None without any."""
    known = [mark for mark in marks if mark is not None]
    return sum(known) / len(known) if known else None


def by_row(episodes: Sequence[Episode], rows: int) -> list[list[Episode]]:
    """Episodes of each learner, in order."""
    sorted_out: list[list[Episode]] = [[] for _ in range(rows)]
    for episode in episodes:
        sorted_out[episode.row].append(episode)
    return sorted_out


def first_success_figures(first: Sequence[FirstSuccess], seeds: Sequence[int]) -> dict[str, Any]:
    """What each seed paid for its first success, for ``summary.json``.

    ``zero_failure_rate``: share of the seeds that succeeded and had not failed before;
    ``never_succeeded``: the seeds without a success.
    """
    return {
        "failures_before_first_success": Spread([f.failures_before for f in first]).as_json(),
        "seconds_before_first_success": Spread([f.seconds_before for f in first]).as_json(),
        "failures_after_first_success": Spread([f.failures_after for f in first]).as_json(),
        "zero_failure_rate": sum(f.succeeded and not f.failures_before for f in first) / len(first),
        "never_succeeded": [s for s, f in zip(seeds, first, strict=True) if not f.succeeded],
    }


GENERIC = ("failure_rate", RETURN, "success_rate", "episode_s")
"""Figures of the episodes of any domain, by their keys in ``summary.json``."""


def generic_figures(episodes: Sequence[Sequence[Episode]]) -> dict[str, Any]:
    """Of the episodes of each seed: the share that failed, the mean return, the share that
    succeeded, the median length in s.  What no episode has is left out."""
    figures: dict[str, Callable[[Sequence[Episode]], float | None]] = {
        "failure_rate": lambda own: _share([e.outcome is Outcome.FAILED for e in own]),
        RETURN: lambda own: _mean([e.total_reward for e in own]),
        "success_rate": lambda own: _share([e.success for e in own]),
        "episode_s": lambda own: _median([e.seconds for e in own]),
    }
    spreads = {name: Spread([figure(own) for own in episodes]) for name, figure in figures.items()}
    optional = (RETURN, "success_rate")
    return {n: s.as_json() for n, s in spreads.items() if s.known or n not in optional}


def measure_figures(
    episodes: Sequence[Sequence[Episode]], measures: Sequence[Measure]
) -> dict[str, Any]:
    """What the sim measures, of the episodes of each seed; see ``sims.base.Measure``."""
    figures: dict[str, Any] = {}
    for measure in measures:
        values = [
            [
                e.measures.get(measure.name, math.nan)
                for e in own
                if e.outcome is Outcome.SUCCEEDED or not measure.successes
            ]
            for own in episodes
        ]
        middle = _median if measure.successes else _mean
        figures[measure.name] = Spread([middle(own) for own in values]).as_json()
        if measure.median:
            figures[measure.median] = Spread([_median(own) for own in values]).as_json()
        if measure.pooled:
            figures[measure.pooled] = _quantiles([v for own in values for v in own])
    return figures


def evaluation_figures(
    episodes: Sequence[Sequence[Episode]], measures: Sequence[Measure], words: Words
) -> dict[str, Any]:
    """All figures of the fresh episodes of each seed, for ``summary.json``, also by the keys that
    the words of the domain make."""
    figures = generic_figures(episodes) | measure_figures(episodes, measures)
    return figures | aliases(figures, words)


def is_defined(episodes: Sequence[Sequence[Episode]], survival: bool | None) -> bool:
    """Whether success is, where ``survival`` is that of the domain (``sims.base.Spec``)."""
    return survival is not None or any(e.success is not None for own in episodes for e in own)


def _quantiles(values: Sequence[float]) -> dict[str, float | None]:
    """median, p95 and max (None of nothing)."""
    ranked = sorted(_finite(values))
    if not ranked:
        return {"median": None, "p95": None, "max": None}
    return {
        "median": statistics.median(ranked),
        "p95": ranked[math.ceil(0.95 * len(ranked)) - 1],
        "max": ranked[-1],
    }


def names_by(words: Words) -> dict[str, str]:
    """From keys of any domain to those that the words of one make: "falls_before_first_ride"."""
    w = words
    return {
        "failures_before_first_success": f"{w.failures}_before_first_{w.success}",
        "seconds_before_first_success": f"seconds_before_first_{w.success}",
        "failures_after_first_success": f"{w.failures}_after_first_{w.success}",
        "zero_failure_rate": f"zero_{w.failure}_rate",
        "never_succeeded": f"never_{w.succeeded}",
        "failure_rate": f"{w.failure}_rate",
        "failures": w.failures,
    }


def aliases(figures: dict[str, Any], words: Words) -> dict[str, Any]:
    """The figures whose keys are others in the words of the domain, by those."""
    return {new: figures[old] for old, new in names_by(words).items() if old in figures}
