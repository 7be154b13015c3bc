"""What a run keeps of its learners: budgets, finished episodes, snapshots.  Plain numbers only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from sims.base import Outcome


@dataclass(frozen=True)
class Budget:
    """What a learner may use; whichever ends first ends it.  None: unlimited.

    seconds: simulated; episodes: ended in any way; successes: episodes that succeeded, and those
    of which nothing is known but that they did not fail.
    """

    seconds: float | None = None
    episodes: int | None = None
    successes: int | None = None

    def __post_init__(self) -> None:
        if self.seconds is None and self.episodes is None and self.successes is None:
            raise ValueError("no budget: give seconds, episodes or successes")

    def in_words(self, successes: str) -> str:
        """For people; successes: what several of them are called."""
        limits = (
            (self.seconds, "simulated s"),
            (self.episodes, "episodes"),
            (self.successes, successes),
        )
        return " or ".join(f"{limit:g} {unit}" for limit, unit in limits if limit is not None)


@dataclass(frozen=True)
class Episode:
    """One finished episode of one learner (or of one evaluated policy).

    row: the learner's place in the population; start: simulated seconds of learning before it;
    seconds: its length; measures: the sim's own figures of it; total_reward: its return, the
    environment's summed reward where it has one, else the sum over time of the configured reward in
    physical units, NaN where there is neither; success: None where the domain knows none.
    """

    row: int
    number: int
    start: float
    seconds: float
    outcome: Outcome
    measures: dict[str, float]
    total_reward: float = math.nan
    success: bool | None = None


_INTEGERS, _FLOATS = ("row", "number", "outcome", "success"), ("start", "seconds", "total_reward")
_UNKNOWN = -1


def episodes_state(episodes: Sequence[Episode]) -> dict[str, Any]:
    """All that is known of episodes of one sim: a tensor ``[E]`` for each field and measure."""
    named = list(episodes[0].measures) if episodes else []
    columns = {name: [getattr(e, name) for e in episodes] for name in (*_INTEGERS, *_FLOATS)}
    columns["success"] = [_UNKNOWN if known is None else known for known in columns["success"]]
    return {
        **{name: torch.tensor(columns[name], dtype=torch.int64) for name in _INTEGERS},
        **{name: torch.tensor(columns[name], dtype=torch.float64) for name in _FLOATS},
        "measures": {
            name: torch.tensor([e.measures[name] for e in episodes], dtype=torch.float64)
            for name in named
        },
    }


def episodes_of(state: Mapping[str, Any]) -> list[Episode]:
    """The episodes that ``episodes_state`` was made of."""
    measures = {name: values.tolist() for name, values in state["measures"].items()}
    columns = (state[name].tolist() for name in (*_INTEGERS, *_FLOATS))
    return [
        Episode(
            row=row,
            number=number,
            start=start,
            seconds=seconds,
            outcome=Outcome(outcome),
            measures={name: values[place] for name, values in measures.items()},
            total_reward=total_reward,
            success=None if success == _UNKNOWN else bool(success),
        )
        for place, (row, number, outcome, success, start, seconds, total_reward) in enumerate(
            zip(*columns, strict=True)
        )
    ]


def nested_state(episodes: Sequence[Sequence[Episode]]) -> dict[str, Any]:
    """``episodes_state`` of several lists at once."""
    together = [e for own in episodes for e in own]
    return {"lengths": [len(own) for own in episodes], "together": episodes_state(together)}


def nested_of(state: Mapping[str, Any]) -> list[list[Episode]]:
    """The lists that ``nested_state`` was made of."""
    together = iter(episodes_of(state["together"]))
    return [[next(together) for _ in range(length)] for length in state["lengths"]]


@dataclass(frozen=True)
class Snapshot:
    """The population at one moment, per learner; value, gradient and error are means since the
    snapshot before (NaN for a learner that did not learn in between).  value_error: the value error
    estimate, where it was asked for."""

    seconds: float
    seeds: list[int]
    active: list[bool]
    episodes: list[int]
    failures: list[int]
    successes: list[int]
    episode_seconds: list[float]
    value: list[float]
    gradient: list[float]
    error: list[float]
    policy_norm: list[float]
    value_error: list[float] | None = None
