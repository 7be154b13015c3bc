"""What a seed had paid at the milestones of its learning.

Its first success is an episode of the learning itself.  For the others its policy is tried at
checkpoints, in evaluation episodes that count as no experience: the policy is stable if none of
them fails, and at the goal if all of them end ``SUCCEEDED``.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from edtorch.run.episodes import Episode
from sims.base import Measure, Outcome


@dataclass(frozen=True)
class FirstSuccess:
    """What a learner paid for its first success; without one, what it has paid so far.

    seconds_before: simulated, up to the start of that episode.
    """

    succeeded: bool
    failures_before: int
    seconds_before: float
    failures_after: int


def first_success(episodes: Sequence[Episode], seconds: float) -> FirstSuccess:
    """From one learner's finished episodes, in order, and its simulated seconds in all."""
    failures = [e.outcome is Outcome.FAILED for e in episodes]
    for index, episode in enumerate(episodes):
        if episode.success:
            before, after = sum(failures[:index]), sum(failures[index:])
            return FirstSuccess(True, before, episode.start, after)
    return FirstSuccess(False, sum(failures), seconds, 0)


@dataclass(frozen=True)
class Checkpoint:
    """One seed's policy at one moment.

    seconds, episodes, failures, cpu_s: paid until then; failure_rate, goal_rate: of ``tried`` fresh
    episodes; measures: means over those that ended ``SUCCEEDED``, of measures of successes;
    success_rate: of those of which it is known (``Episode.success``), NaN without any.
    """

    seconds: float
    episodes: int
    failures: int
    cpu_s: float
    tried: int
    failure_rate: float
    goal_rate: float
    measures: Mapping[str, float] = field(default_factory=dict)
    success_rate: float = math.nan

    @property
    def stable(self) -> bool:
        """No failure."""
        return self.failure_rate == 0

    @property
    def to_the_goal(self) -> bool:
        """Nothing but successes."""
        return self.goal_rate == 1


def checkpoint(
    fresh: Sequence[Episode],
    measures: Sequence[Measure],
    *,
    seconds: float,
    failures: int,
    episodes: int,
    cpu_s: float,
) -> Checkpoint:
    """From the fresh episodes of one policy, at least one; the rest: paid until then."""
    known = [e.success for e in fresh if e.success is not None]
    reached = [e for e in fresh if e.outcome is Outcome.SUCCEEDED]
    means: dict[str, float] = {}
    for measure in measures:
        if measure.successes and reached:
            means[measure.name] = statistics.fmean(e.measures[measure.name] for e in reached)
    return Checkpoint(
        seconds=seconds,
        episodes=episodes,
        failures=failures,
        cpu_s=cpu_s,
        tried=len(fresh),
        failure_rate=sum(e.outcome is Outcome.FAILED for e in fresh) / len(fresh),
        goal_rate=len(reached) / len(fresh),
        measures=means,
        success_rate=sum(known) / len(known) if known else math.nan,
    )


MILESTONES = {"stable": "stable", "goal": "to_the_goal"}
"""Names in ``summary.json``, and the properties of a ``Checkpoint`` that say whether it is one."""
