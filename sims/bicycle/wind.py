"""Gusts of wind: a force from the side that comes, lasts a while, and goes.

Gusts begin at random: after ``every`` seconds on average, but not before the one before is over.
Each has a force of its own, normal around zero, which it keeps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sims.normal import normal_quantile


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
        begins, size = uniforms.unbind(0)
        calm = left < 0.5
        begins = calm & (begins < self.chance)
        force = torch.where(begins, self.force * normal_quantile(size), force * ~calm)
        left = torch.where(begins, float(self.steps), left) - 1
        return force, left.clamp(min=0.0)

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
