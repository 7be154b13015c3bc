"""The best policy of each learner so far, by fresh episodes that no figure is reported of.

A policy that goes on learning may get worse; one that is chosen by the episodes it is then praised
for looks better than it is.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.report.statistics import Spread, goal_figures
from edtorch.run.episodes import Episode
from edtorch.types import Parameters
from sims.base import Outcome

Score = tuple[float, float]
"""Share of the episodes that failed, and mean of the sim's first measure; the less the better."""


def score(episodes: Sequence[Episode]) -> Score:
    """Of a policy, from at least one episode."""
    failed = sum(e.outcome is Outcome.FAILED for e in episodes) / len(episodes)
    return failed, statistics.fmean(next(iter(e.measures.values())) for e in episodes)


@dataclass(frozen=True)
class Kept:
    """The best so far of S learners: its parameters ``[S, ...]``, and of each learner the score,
    the minutes of learning, and the episodes to report."""

    parameters: Parameters
    scores: list[Score]
    minutes: list[float]
    episodes: list[list[Episode]]

    def as_json(self) -> dict[str, Any]:
        """For ``summary.json``."""
        return {"minutes": Spread([*self.minutes]).as_json(), **goal_figures(self.episodes)}


def better(
    old: Kept | None,
    parameters: Parameters,
    minutes: float,
    judged: Sequence[Sequence[Episode]],
    reported: Sequence[Sequence[Episode]],
) -> Kept:
    """``old``, with the new policy of each learner that did better in the episodes ``judged``."""
    scores = [score(own) for own in judged]
    new = Kept(
        {name: p.clone() for name, p in parameters.items()},
        scores,
        [minutes] * len(scores),
        [list(own) for own in reported],
    )
    if old is None:
        return new
    for row, before in enumerate(old.scores):
        if before <= scores[row]:
            for name, p in new.parameters.items():
                p[row] = old.parameters[name][row]
            new.scores[row], new.minutes[row] = before, old.minutes[row]
            new.episodes[row] = old.episodes[row]
    return new
