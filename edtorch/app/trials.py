"""Policies tried on the way, in fresh episodes that count as no experience of theirs.

What both a learner's run and a rival's need to report what was paid before a milestone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from edtorch.run.episodes import Episode, nested_of, nested_state
from edtorch.run.milestones import MILESTONES, Checkpoint, checkpoint
from sims.base import Measure, Outcome

SCREENING = 2
"""Fresh episodes that a policy, unless it was stable at its last trial, must end without a failure
before it is tried in all of them: one that fails in one of these is not stable, and most on the way
fail."""

Fresh = Callable[[Sequence[int], int], Sequence[list[Episode]]]
"""The first ``count`` evaluation episodes of the current policy of each row; a longer list extends
a shorter one."""


@dataclass(frozen=True)
class Paid:
    """What one seed has paid until now; seconds: simulated; episodes: ended in any way."""

    seconds: float
    episodes: int
    failures: int
    cpu_s: float


def _stable(episodes: Sequence[Episode]) -> bool:
    return not any(e.outcome is Outcome.FAILED for e in episodes)


class Trials:
    """Evaluation episodes of the current policies, and the results of earlier ones.

    episodes: of each trial; screening: see ``SCREENING``; history: the checkpoints of each row, in
    order; last: the episodes of its last one, only ``screening`` of them where one failed.
    """

    def __init__(
        self,
        rows: int,
        episodes: int,
        fresh: Fresh,
        measures: Sequence[Measure] = (),
        *,
        screening: int = SCREENING,
    ) -> None:
        self._most, self._screening = episodes, screening
        self._measures = measures
        self._fresh = fresh
        self.history: list[list[Checkpoint]] = [[] for _ in range(rows)]
        self.last: list[list[Episode]] = [[] for _ in range(rows)]

    def state(self) -> dict[str, Any]:
        """What there has been, as ``edtorch.run.state_file`` takes it."""
        return {
            "history": [[asdict(point) for point in own] for own in self.history],
            "last": nested_state(self.last),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from such a state."""
        self.history = [[Checkpoint(**point) for point in own] for own in state["history"]]
        self.last = nested_of(state["last"])

    def _episodes(self, rows: Sequence[int], count: int) -> None:
        if rows:
            for row, own in zip(rows, self._fresh(rows, count), strict=True):
                self.last[row] = own

    def run(self, rows: Sequence[int], paid: Callable[[int], Paid]) -> dict[int, Checkpoint]:
        """Try those of ``rows``; paid: by each until now."""
        # One that was stable the last time most likely still is, and one full-length episode takes
        # as long as many side by side.
        stable = {row for row in rows if self.history[row] and self.history[row][-1].stable}
        self._episodes([row for row in rows if row not in stable], min(self._screening, self._most))
        if self._most > self._screening:
            stable |= {row for row in rows if row not in stable and _stable(self.last[row])}
        self._episodes([row for row in rows if row in stable], self._most)
        return {row: self.record(row, self.last[row], paid(row)) for row in rows}

    def record(self, row: int, episodes: list[Episode], paid: Paid) -> Checkpoint:
        """A checkpoint of fresh episodes that somebody else has run."""
        found = checkpoint(
            episodes,
            self._measures,
            seconds=paid.seconds,
            failures=paid.failures,
            episodes=paid.episodes,
            cpu_s=paid.cpu_s,
        )
        self.last[row] = episodes
        self.history[row].append(found)
        return found

    def complete(self) -> list[list[Episode]]:
        """All episodes of the last policies, those that were only screened included."""
        short = [row for row, own in enumerate(self.last) if len(own) < self._most]
        self._episodes(short, self._most)
        return self.last

    def reached(self, milestone: str) -> list[bool]:
        """Of each row, whether it has been there."""
        told = MILESTONES[milestone]
        return [any(getattr(c, told) for c in own) for own in self.history]
