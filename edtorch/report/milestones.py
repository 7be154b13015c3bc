"""What a learner or rival had paid when its policy first never failed, and first always succeeded.

Policies are tried at checkpoints, in fresh episodes that count as no experience.  One is stable
if none of them fails, and at the goal if all of them end ``SUCCEEDED``.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from edtorch.report.domain import Domain
from edtorch.report.statistics import Spread, aliases
from edtorch.run.episodes import Episode
from sims.base import Measure, Outcome


@dataclass(frozen=True)
class Checkpoint:
    """One seed's policy at one moment.

    seconds, episodes, failures, cpu_s: paid until then; failure_rate, goal_rate: of ``tried`` fresh
    episodes; measures: means over those that ended ``SUCCEEDED``, of measures of successes.
    """

    seconds: float
    episodes: int
    failures: int
    cpu_s: float
    tried: int
    failure_rate: float
    goal_rate: float
    measures: Mapping[str, float] = field(default_factory=dict)

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
    )


PAID = ("seconds", "episodes", "failures", "cpu_s")
MILESTONES = {"stable": "stable", "goal": "to_the_goal"}
"""Names in ``summary.json``, and the properties of a ``Checkpoint`` that say whether it is one."""


def milestones(
    history: Sequence[Sequence[Checkpoint]], seeds: Sequence[int], domain: Domain
) -> dict[str, Any]:
    """For ``summary.json``: of each milestone what each seed had paid there, and ``never``: the
    seeds that did not get there, for which it is what they had paid in the end.  Of the goal
    nothing where the domain has none.

    history: the checkpoints of each seed, in order, at least one each.
    """
    found: dict[str, Any] = {}
    for name, told in MILESTONES.items():
        first = [next((c for c in own if getattr(c, told)), None) for own in history]
        if name == "goal" and not (domain.has_goal or any(first)):
            continue
        at = [c or own[-1] for c, own in zip(first, history, strict=True)]
        paid = {key: Spread([getattr(c, key) for c in at]).as_json() for key in PAID}
        measured = {
            m.name: Spread([c and c.measures.get(m.name, math.nan) for c in first]).as_json()
            for m in domain.measures
            if m.successes
        }
        never = [seed for seed, c in zip(seeds, first, strict=True) if c is None]
        found[name] = {**paid, **aliases(paid, domain.words), **measured, "never": never}
    return found


AT_CHECKPOINTS = (*PAID, "failure_rate", "goal_rate")


def checkpoints(history: Sequence[Sequence[Checkpoint]], domain: Domain) -> list[dict[str, Any]]:
    """For ``summary.json``: the k-th of each seed beside each other, null where there is none."""
    found: list[dict[str, Any]] = []
    for k in range(max(map(len, history))):
        figures = {
            name: Spread(
                [getattr(own[k], name) if k < len(own) else None for own in history]
            ).as_json()
            for name in AT_CHECKPOINTS
        }
        found.append(figures | aliases(figures, domain.words))
    return found
