"""What each seed of a rival has paid: simulated seconds, episodes, failures, its first success.

A rival may need hundreds of thousands of episodes; they are counted here and not kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from torch import Tensor

from edtorch.run.episodes import Budget
from edtorch.run.milestones import FirstSuccess
from edtorch.run.scaled_sim import World
from sims.base import Outcome


@dataclass(frozen=True)
class FirstGoal:
    """The first episode of a search that reached the goal.

    episodes, failures, paid: how many, and simulated seconds, up to its end; seconds: its own.
    """

    episodes: int
    failures: int
    paid: float
    seconds: float


@dataclass
class Account:
    """Of one seed.  seconds: simulated, those of an unfinished episode included; first: failures
    and seconds before the first success, None without one; goal: the first episode that ended at
    the goal, if any."""

    seconds: float = 0.0
    episodes: int = 0
    failures: int = 0
    successes: int = 0
    first: tuple[int, float] | None = None
    goal: FirstGoal | None = None

    def state(self) -> dict[str, Any]:
        """All of it, for ``of``."""
        return {**asdict(self), "first": None if self.first is None else list(self.first)}

    @staticmethod
    def of(state: Mapping[str, Any]) -> Account:
        """The account of this ``state``."""
        first, goal = state["first"], state["goal"]
        own = {"first": first and tuple(first), "goal": goal and FirstGoal(**goal)}
        return Account(**{**state, **own})

    def spend(self, seconds: float) -> None:
        """So many simulated seconds more, of whatever episode."""
        self.seconds += seconds

    def end(self, outcome: Outcome, seconds: float, *, success: bool) -> None:
        """An episode is over that lasted so many seconds, which have been spent already.

        RUNNING is an episode that was cut off.  success: by the rules of the domain
        (``edtorch.run.success``).
        """
        self.episodes += 1
        if outcome is Outcome.FAILED:
            self.failures += 1
        elif success:
            self.successes += 1
            if self.first is None:
                self.first = (self.failures, self.seconds - seconds)
        if outcome is Outcome.SUCCEEDED and self.goal is None:
            self.goal = FirstGoal(self.episodes, self.failures, self.seconds, seconds)

    @property
    def first_success(self) -> FirstSuccess:
        """As of a learner."""
        if self.first is None:
            return FirstSuccess(False, self.failures, self.seconds, 0)
        failures, seconds = self.first
        return FirstSuccess(True, failures, seconds, self.failures - failures)

    def within(self, budget: Budget) -> bool:
        """Whether the seed may go on."""
        limits = (
            (self.seconds, budget.seconds),
            (self.episodes, budget.episodes),
            (self.successes, budget.successes),
        )
        return all(limit is None or used < limit for used, limit in limits)


def pay(account: Account, world: World, state: Tensor, outcome: Tensor, ticks: Tensor) -> None:
    """Enter episodes in order: their final states ``[E, k]``, outcomes and ticks ``[E]``.

    One that is out of time before the world's own time limit was cut off.
    """
    success = world.success(state, outcome) != 0
    entries = zip(outcome.tolist(), ticks.tolist(), success.tolist(), strict=True)
    for end, count, succeeded in entries:
        cut = end == Outcome.TIMED_OUT and count < world.limit_ticks
        how = Outcome.RUNNING if cut else Outcome(end)
        account.spend(count * world.dt)
        account.end(how, count * world.dt, success=succeeded and how is not Outcome.RUNNING)
