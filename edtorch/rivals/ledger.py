"""What each seed of a rival has paid: simulated seconds, episodes, falls, and its first ride.

A rival may need hundreds of thousands of episodes; they are counted here and not kept.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.report.statistics import FirstSuccess
from edtorch.run.episodes import RIDES, Budget
from edtorch.run.scaled_sim import World
from sims.base import Outcome


@dataclass(frozen=True)
class FirstGoal:
    """The first episode of a search that reached the goal.

    episodes, falls, paid: how many, and simulated seconds, up to its end; seconds: its own.
    """

    episodes: int
    falls: int
    paid: float
    seconds: float


@dataclass
class Account:
    """Of one seed.  seconds: simulated, those of an unfinished episode included; first: what was
    paid before the first ride, None without one; goal: the first that ended there, if any."""

    seconds: float = 0.0
    episodes: int = 0
    falls: int = 0
    rides: int = 0
    first: tuple[int, float] | None = None
    goal: FirstGoal | None = None

    def spend(self, seconds: float) -> None:
        """So many simulated seconds more, of whatever episode."""
        self.seconds += seconds

    def end(self, outcome: Outcome, seconds: float) -> None:
        """An episode is over that lasted so many seconds, which have been spent already.

        RUNNING is an episode that was cut off: neither a fall nor a ride.
        """
        self.episodes += 1
        if outcome is Outcome.FAILED:
            self.falls += 1
        elif outcome in RIDES:
            self.rides += 1
            if self.first is None:
                self.first = (self.falls, self.seconds - seconds)
        if outcome is Outcome.SUCCEEDED and self.goal is None:
            self.goal = FirstGoal(self.episodes, self.falls, self.seconds, seconds)

    def add(self, outcome: Outcome, seconds: float) -> None:
        """An episode of so many seconds, from its start to its end."""
        self.spend(seconds)
        self.end(outcome, seconds)

    @property
    def first_success(self) -> FirstSuccess:
        """As of a learner (``edtorch.report.statistics``)."""
        if self.first is None:
            return FirstSuccess(False, self.falls, self.seconds, 0)
        falls, seconds = self.first
        return FirstSuccess(True, falls, seconds, self.falls - falls)

    def within(self, budget: Budget) -> bool:
        """Whether the seed may go on."""
        limits = (
            (self.seconds, budget.seconds),
            (self.episodes, budget.episodes),
            (self.rides, budget.rides),
        )
        return all(limit is None or used < limit for used, limit in limits)


def pay(account: Account, outcome: Tensor, ticks: Tensor, world: World) -> None:
    """Many episodes at once, in order: their outcome and ticks ``[E]``; one that is out of time
    before the world's own time limit was cut off."""
    for end, count in zip(outcome.tolist(), ticks.tolist(), strict=True):
        cut = end == Outcome.TIMED_OUT and count < world.limit_ticks
        account.add(Outcome.RUNNING if cut else Outcome(end), count * world.dt)
