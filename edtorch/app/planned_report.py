"""The report of a search between trials: after each trial, and at its end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.app.planned_progress import SeedProgress
from edtorch.app.solved import finite_or_null, to_solved
from edtorch.run.episodes import Episode
from edtorch.run.log import Entry, median_known

TRIAL_COLUMNS = (
    *("trial", "seed", "seconds", "whole"),
    *("success_rate", "mean_return", "solved", "cpu_s"),
)


@dataclass(frozen=True)
class TrialOutcome:
    """The result of one seed's trial; row: the seed's place in the population; whole: whether it
    went to its end; success_rate, mean_return: of the policy after it in fresh episodes; figures:
    of the improvement, by name."""

    row: int
    whole: bool
    success_rate: float
    mean_return: float
    figures: Mapping[str, float]

    @classmethod
    def of(
        cls, row: int, whole: bool, fresh: Sequence[Episode], figures: Mapping[str, float]
    ) -> TrialOutcome:
        """With the rate and the mean over fresh episodes; NaN where there is none."""
        known = [e.success for e in fresh if e.success is not None]
        returns = [e.total_reward for e in fresh]
        rate = sum(known) / len(known) if known else math.nan
        mean_return = sum(returns) / len(returns) if returns else math.nan
        return cls(row, whole, rate, mean_return, figures)


def trial_entry(
    number: int,
    outcomes: Sequence[TrialOutcome],
    progress: Sequence[SeedProgress],
    seeds: Sequence[int],
    names: Sequence[str],
    episodes: Sequence[Episode],
    cpu_s: float,
) -> Entry:
    """Of the trial ``number``, from 0.

    outcomes: of the seeds that had it; progress, seeds: of the whole population; names: of the
    figures of an improvement; episodes: of all trials; cpu_s: that this one has taken.
    """
    scalars = {
        "search/solved": float(sum(each.solved is not None for each in progress)),
        "search/success_rate": median_known([each.success_rate for each in outcomes]),
        "search/mean_return": median_known([each.mean_return for each in outcomes]),
    }
    for name in names:
        values = [each.figures.get(name, math.nan) for each in outcomes]
        scalars[f"search/{name}"] = median_known(values)
    seconds = max(each.seconds for each in progress)
    return Entry(
        rows=[_row(number, each, progress[each.row], seeds[each.row], names) for each in outcomes],
        scalars=scalars,
        step=number + 1,
        episodes=[(seeds[e.row], e) for e in episodes if e.number == number],
        news=f"trial {number + 1}, {seconds:g} s: solved {scalars['search/solved']:.0f} of"
        f" {len(seeds)}; success rate {scalars['search/success_rate']:.2f} (median of this trial's"
        f" policies), {cpu_s:.1f} CPU s",
    )


def _row(
    number: int, outcome: TrialOutcome, progress: SeedProgress, seed: int, names: Sequence[str]
) -> tuple[Any, ...]:
    """Of ``metrics.csv``: ``TRIAL_COLUMNS``, then the figures."""
    return (
        *(number + 1, seed, progress.seconds, int(outcome.whole)),
        *(outcome.success_rate, outcome.mean_return, int(progress.solved is not None)),
        progress.cpu_s[-1] if progress.cpu_s else math.nan,
        *(outcome.figures.get(name, math.nan) for name in names),
    )


def solved_figures(progress: Sequence[SeedProgress], seeds: Sequence[int]) -> dict[str, Any]:
    """For ``summary.json``: what it took to solve the task, an unsolved seed counting as
    infinity."""
    return {
        "seconds_to_solved": to_solved([each.solved for each in progress]),
        "trials_to_solved": to_solved([each.solved_trials for each in progress]),
        "never_solved": [
            seed for seed, each in zip(seeds, progress, strict=True) if each.solved is None
        ],
        "success_rate_after_trial": [
            [finite_or_null(rate) for rate in each.rates] for each in progress
        ],
        "seconds_after_trial": [each.seconds_after for each in progress],
        "cpu_s_of_trial": [each.cpu_s for each in progress],
        "simulated_seconds": [each.seconds for each in progress],
    }


def solved_words(summary: Mapping[str, Any]) -> str:
    """For the terminal: how many seeds have solved their task, and what it took."""
    size, never = len(summary["seeds"]), len(summary["never_solved"])
    median = summary["seconds_to_solved"]["median"]
    middle = "never" if median is None else f"{median:g} s"
    return f"solved: {size - never} of {size} seeds; median {middle}"
