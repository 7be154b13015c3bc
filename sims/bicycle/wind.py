"""Gusts of wind: a force from the side that comes, lasts a while, and goes.

Gusts begin at random: after ``every`` seconds on average, but not before the one before is over.
Each has a force of its own, normal around zero, which it keeps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from sims.normal import normal_quantile_over
from sims.rows import TORCH, Function, Namespace


def gusts_over(xp: Namespace) -> Function:
    """Gusts over rows: a function of the force (N, positive to the left) and how many steps the
    gust has left, after the step before, two uniforms, and a Gusts' ``force``, ``steps`` and
    ``chance``; the same two rows after this step."""
    quantile = normal_quantile_over(xp)

    @xp.jit
    def blow(force, left, begins, size, strength, steps, chance):
        calm = left < 0.5
        begins = xp.both(calm, begins < chance)
        kept = force * xp.as_number(xp.negated(calm))
        force = xp.where(begins, strength * quantile(size), kept)
        return force, xp.maximum(xp.where(begins, steps, left) - 1, 0.0)

    return blow


_BLOW = gusts_over(TORCH)


@dataclass(frozen=True)
class Gusts:
    """``force``: standard deviation, N; ``seconds``: how long each lasts; ``every``: seconds from
    the beginning of one to that of the next, on average; ``dt``: seconds per step."""

    force: float
    seconds: float
    every: float
    dt: float

    @property
    def steps(self) -> int:
        """How many steps a gust lasts."""
        return round(self.seconds / self.dt)

    @property
    def chance(self) -> float:
        """Probability that a gust begins in a step without one.

        From the last step of a gust it then takes 1 / chance steps on average to the first of the
        next, and the gust itself ``steps`` - 1 more.
        """
        return 1 / (self.every / self.dt - self.steps + 1)

    def blow(self, force: Tensor, left: Tensor, uniforms: Tensor) -> tuple[Tensor, Tensor]:
        """The force (N, positive to the left) of a step, and how many steps the gust has left after
        it, from those of the step before, all ``[*batch]``, and uniforms ``[2, *batch]``."""
        constants = self.force, float(self.steps), self.chance
        return _BLOW(force, left, *uniforms.unbind(0), *constants)

    def __post_init__(self) -> None:
        """Refuse what no wind does."""
        for name in ("force", "seconds", "every", "dt"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}={value}: expected a finite number above 0")
        if self.steps < 1:
            raise ValueError(f"seconds={self.seconds}: expected at least a step of {self.dt} s")
        if self.seconds > self.every:
            raise ValueError(f"seconds={self.seconds}: expected at most every, {self.every} s")
