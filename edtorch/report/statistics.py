"""Figures of a run over its seeds; the seed is the unit, whatever it did in between."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.run.episodes import Episode
from sims.base import Outcome


@dataclass(frozen=True)
class Spread:
    """One figure per seed (None: this seed has none), with its median and extremes."""

    per_seed: list[float | None]

    @property
    def known(self) -> list[float]:
        """The figures that there are."""
        return [v for v in self.per_seed if v is not None and math.isfinite(v)]

    @property
    def median(self) -> float | None:
        """Median over the seeds that have the figure."""
        return statistics.median(self.known) if self.known else None

    def as_json(self) -> dict[str, Any]:
        """``per_seed``, ``median``, ``min``, ``max``; null where there is none."""
        known = self.known
        return {
            "per_seed": [v if v is not None and math.isfinite(v) else None for v in self.per_seed],
            "median": self.median,
            "min": min(known) if known else None,
            "max": max(known) if known else None,
        }


@dataclass(frozen=True)
class FirstRide:
    """What a learner paid for its first ride; without one, what it has paid so far."""

    rode: bool
    falls_before: int
    seconds_before: float
    falls_after: int


def first_ride(episodes: Sequence[Episode], seconds: float) -> FirstRide:
    """From one learner's finished episodes, in order, and its simulated seconds in all."""
    falls = [e.outcome is Outcome.FAILED for e in episodes]
    for index, episode in enumerate(episodes):
        if episode.is_ride:
            return FirstRide(True, sum(falls[:index]), episode.start, sum(falls[index:]))
    return FirstRide(False, sum(falls), seconds, 0)


def by_row(episodes: Sequence[Episode], rows: int) -> list[list[Episode]]:
    """Episodes of each learner, in order."""
    sorted_out: list[list[Episode]] = [[] for _ in range(rows)]
    for episode in episodes:
        sorted_out[episode.row].append(episode)
    return sorted_out


def learning_figures(
    episodes: Sequence[Episode], seeds: Sequence[int], seconds: Sequence[float]
) -> dict[str, Any]:
    """The figures of the learning itself, for ``summary.json``."""
    per_seed = [
        first_ride(own, lived)
        for own, lived in zip(by_row(episodes, len(seeds)), seconds, strict=True)
    ]
    return first_ride_figures(per_seed, seeds)


def first_ride_figures(per_seed: Sequence[FirstRide], seeds: Sequence[int]) -> dict[str, Any]:
    """What each seed paid for its first ride, for ``summary.json``."""
    return {
        "falls_before_first_ride": Spread([r.falls_before for r in per_seed]).as_json(),
        "seconds_before_first_ride": Spread([r.seconds_before for r in per_seed]).as_json(),
        "falls_after_first_ride": Spread([r.falls_after for r in per_seed]).as_json(),
        "zero_fall_rate": sum(r.rode and r.falls_before == 0 for r in per_seed) / len(per_seed),
        "never_rode": [s for s, r in zip(seeds, per_seed, strict=True) if not r.rode],
    }


def _median_or_none(values: Sequence[float]) -> float | None:
    numbers = [v for v in values if math.isfinite(v)]
    return statistics.median(numbers) if numbers else None


def _over_shortest(episode: Episode) -> float:
    shortest = episode.measures.get("shortest_time_s", math.nan)
    return episode.seconds / shortest if shortest > 0 else math.nan


def evaluation_figures(evaluated: Sequence[Sequence[Episode]]) -> dict[str, Any]:
    """The figures of fresh episodes, per seed: the goal rate, the median of everything else; and
    ``goal_time_all_s``, the quantiles of the time over all episodes of all seeds.

    ``goal_time_s`` and the sim's own measures are those of the episodes that reached the goal;
    ``fall_rate`` beside ``goal_rate`` tells a timeout from a fall.
    """
    reached = [[e for e in own if e.outcome is Outcome.SUCCEEDED] for own in evaluated]
    figures: dict[str, Any] = {
        "goal_rate": Spread(
            [len(r) / len(own) if own else None for r, own in zip(reached, evaluated, strict=True)]
        ).as_json(),
        "fall_rate": Spread(
            [
                sum(e.outcome is Outcome.FAILED for e in own) / len(own) if own else None
                for own in evaluated
            ]
        ).as_json(),
        "goal_time_s": Spread([_median_or_none([e.seconds for e in r]) for r in reached]).as_json(),
        "goal_time_all_s": _quantiles([e.seconds for r in reached for e in r]),
        "path_length_m": Spread(_measure(reached, "path_length_m")).as_json(),
        "goal_time_over_shortest": Spread(
            [_median_or_none([_over_shortest(e) for e in r]) for r in reached]
        ).as_json(),
        "episode_s": Spread(
            [_median_or_none([e.seconds for e in own]) for own in evaluated]
        ).as_json(),
    }
    return figures


def _quantiles(values: Sequence[float]) -> dict[str, float | None]:
    """median, p95 and max (None of nothing)."""
    if not values:
        return {"median": None, "p95": None, "max": None}
    ranked = sorted(values)
    return {
        "median": statistics.median(ranked),
        "p95": ranked[math.ceil(0.95 * len(ranked)) - 1],
        "max": ranked[-1],
    }


def _measure(episodes: Sequence[Sequence[Episode]], name: str) -> list[float | None]:
    return [_median_or_none([e.measures.get(name, math.nan) for e in own]) for own in episodes]


MEDIANS = {"joint_error_rad": "joint_error_median_rad"}
"""Measures of which the median over the episodes is told beside the mean, under this name."""


def goal_figures(evaluated: Sequence[Sequence[Episode]]) -> dict[str, Any]:
    """The figures of fresh episodes of a family of tasks, per seed: means over all episodes of the
    sim's own measures at their ends, crashes included, and the shares that crashed or succeeded."""
    names = next((list(e.measures) for own in evaluated for e in own), [])
    figures: dict[str, Any] = {}
    for name in names:
        values = [[e.measures[name] for e in own] for own in evaluated]
        figures[name] = Spread([statistics.fmean(own) for own in values]).as_json()
        if name in MEDIANS:
            figures[MEDIANS[name]] = Spread([statistics.median(own) for own in values]).as_json()
    for name, outcome in (("crash_rate", Outcome.FAILED), ("success_rate", Outcome.SUCCEEDED)):
        figures[name] = Spread(
            [
                sum(e.outcome is outcome for e in own) / len(own) if own else None
                for own in evaluated
            ]
        ).as_json()
    return figures
