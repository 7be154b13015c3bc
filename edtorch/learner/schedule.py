"""When the policy is improved: as often as it pays while little is known, seldom later."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Schedule:
    """Improve at tick ``first`` and every one after it up to ``often``, then every ``every``-th.

    All in ticks.  The model is fitted at each tick all the same.  A tick's number decides, not what
    a learner has seen, so that a population does the same thing at the same time.
    """

    first: int = 1
    often: int = 0
    every: int = 1

    def __post_init__(self) -> None:
        for name, least in (("first", 1), ("often", 0), ("every", 1)):
            if not getattr(self, name) >= least:
                raise ValueError(f"{name}={getattr(self, name)}: expected {least} or more ticks")

    def improves(self, clock: int) -> bool:
        """Whether the policy is improved at the tick of this number, from 1."""
        return clock >= self.first and (clock <= self.often or clock % self.every == 0)


def schedule_for(unknowns: int, first: int | None, often: int | None, every: int) -> Schedule:
    """With what is None chosen for a model of that many unknowns in each equation: the first
    improvement after as many ticks, and one at every tick up to ``SETTLED``."""
    return Schedule(
        unknowns if first is None else first, SETTLED if often is None else often, every
    )


SETTLED = 1000
"""Ticks after which a policy that is improved at each of them hardly changes any more."""

ALWAYS = Schedule()
"""At each tick, as in Fig. 1."""
