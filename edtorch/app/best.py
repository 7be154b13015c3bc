"""The best policy of each learner so far, by fresh episodes that no figure is reported of.

A policy that goes on learning may get worse; one that is chosen by the episodes it is then praised
for looks better than it is.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.report.domain import Domain
from edtorch.report.statistics import Spread, evaluation_figures
from edtorch.run.episodes import Episode, nested_of, nested_state
from edtorch.types import Parameters
from sims.base import Outcome

Score = tuple[float, float, float]
"""Share of the episodes that succeeded, share that did not fail, mean return; the more the better.
The second decides where success is not defined, or as long as there is none: a return of negative
rewards would prefer an early failure."""


def score(episodes: Sequence[Episode]) -> Score:
    """Of a policy, from at least one episode."""
    succeeded = sum(bool(e.success) for e in episodes) / len(episodes)
    sound = sum(e.outcome is not Outcome.FAILED for e in episodes) / len(episodes)
    returns = [e.total_reward for e in episodes if math.isfinite(e.total_reward)]
    return succeeded, sound, statistics.fmean(returns) if returns else -math.inf


@dataclass(frozen=True)
class Kept:
    """The best so far of S learners: its parameters ``[S, ...]``, and of each learner the score,
    the minutes of learning, and the episodes to report."""

    parameters: Parameters
    scores: list[Score]
    minutes: list[float]
    episodes: list[list[Episode]]

    def state(self) -> dict[str, Any]:
        """For ``of``."""
        return {
            "parameters": self.parameters,
            "scores": self.scores,
            "minutes": self.minutes,
            "episodes": nested_state(self.episodes),
        }

    @staticmethod
    def of(state: Mapping[str, Any]) -> Kept:
        """What ``state`` was made of."""
        scores: list[Score] = [(own[0], own[1], own[2]) for own in state["scores"]]
        episodes = nested_of(state["episodes"])
        return Kept(dict(state["parameters"]), scores, list(state["minutes"]), episodes)

    def as_json(self, domain: Domain) -> dict[str, Any]:
        """For ``summary.json``."""
        figures = evaluation_figures(self.episodes, domain.measures, domain.words)
        return {"minutes": Spread([*self.minutes]).as_json(), **figures}


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
        if before >= scores[row]:
            for name, p in new.parameters.items():
                p[row] = old.parameters[name][row]
            new.scores[row], new.minutes[row] = before, old.minutes[row]
            new.episodes[row] = old.episodes[row]
    return new
