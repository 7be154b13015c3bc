"""What a learner or rival had paid when its policy first rode, and first rode to the goal.

Policies are tried at checkpoints, in fresh episodes that count as no experience.  One is stable
if none of them ends in a fall, and it rides to the goal if all of them end there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.report.statistics import Spread
from edtorch.run.episodes import Episode
from sims.base import Outcome


@dataclass(frozen=True)
class Checkpoint:
    """One seed's policy at one moment.

    seconds, episodes, falls, cpu_s: paid until then; fall_rate, goal_rate: of ``tried`` fresh
    episodes; path_length_m: mean of those that reached the goal, NaN without one.
    """

    seconds: float
    episodes: int
    falls: int
    cpu_s: float
    tried: int
    fall_rate: float
    goal_rate: float
    path_length_m: float = math.nan

    @property
    def stable(self) -> bool:
        """No fall."""
        return self.fall_rate == 0

    @property
    def to_the_goal(self) -> bool:
        """Always at the goal."""
        return self.goal_rate == 1


def checkpoint(
    episodes: Sequence[Episode], *, seconds: float, falls: int, paid: int, cpu_s: float
) -> Checkpoint:
    """From the fresh episodes of one policy, at least one; paid: episodes of its learning."""
    reached = [e for e in episodes if e.outcome is Outcome.SUCCEEDED]
    lengths = [e.measures.get("path_length_m", math.nan) for e in reached]
    return Checkpoint(
        seconds=seconds,
        episodes=paid,
        falls=falls,
        cpu_s=cpu_s,
        tried=len(episodes),
        fall_rate=sum(e.outcome is Outcome.FAILED for e in episodes) / len(episodes),
        goal_rate=len(reached) / len(episodes),
        path_length_m=math.fsum(lengths) / len(lengths) if lengths else math.nan,
    )


PAID = ("seconds", "episodes", "falls", "cpu_s")
MILESTONES = {"stable": "stable", "goal": "to_the_goal"}
"""Names in ``summary.json``, and the properties of a ``Checkpoint`` that say whether it is one."""


def milestones(history: Sequence[Sequence[Checkpoint]], seeds: Sequence[int]) -> dict[str, Any]:
    """For ``summary.json``: of each milestone what each seed had paid there, and ``never``: the
    seeds that did not get there, for which it is what they had paid in the end.

    history: the checkpoints of each seed, in order, at least one each.
    """
    found: dict[str, Any] = {}
    for name, told in MILESTONES.items():
        first = [next((c for c in own if getattr(c, told)), None) for own in history]
        at = [c or own[-1] for c, own in zip(first, history, strict=True)]
        lengths = [None if c is None else c.path_length_m for c in first]
        found[name] = {
            **{key: Spread([getattr(c, key) for c in at]).as_json() for key in PAID},
            "path_length_m": Spread(lengths).as_json(),
            "never": [seed for seed, c in zip(seeds, first, strict=True) if c is None],
        }
    return found


AT_CHECKPOINTS = (*PAID, "fall_rate", "goal_rate")


def checkpoints(history: Sequence[Sequence[Checkpoint]]) -> list[dict[str, Any]]:
    """For ``summary.json``: the k-th of each seed beside each other, null where there is none."""
    return [
        {
            name: Spread(
                [getattr(own[k], name) if k < len(own) else None for own in history]
            ).as_json()
            for name in AT_CHECKPOINTS
        }
        for k in range(max(map(len, history)))
    ]
