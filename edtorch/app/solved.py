"""When a task counts as solved, and what was paid until then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.app.checks import positive
from edtorch.app.errors import ConfigError
from edtorch.app.settings import Settings
from edtorch.report.experience import median_seconds
from edtorch.run.milestones import Checkpoint


@dataclass(frozen=True)
class Solved:
    """When a task counts as solved: a success rate of at least ``rate`` and a mean return of at
    least ``mean_return``, in fresh episodes; None: not required."""

    rate: float | None
    mean_return: float | None
    episodes: int

    @property
    def asked(self) -> bool:
        """Whether there is a criterion."""
        return self.rate is not None or self.mean_return is not None

    def holds(self, rate: float, mean_return: float = math.nan) -> bool:
        """Whether these figures meet it."""
        good = self.rate is None or rate >= self.rate
        return self.asked and good and (self.mean_return is None or mean_return >= self.mean_return)


def build_solved(config: Settings) -> Solved:
    """The group ``eval.solved``.  Raises ConfigError."""
    asked = dict(config.eval.solved)
    rate, mean_return = asked.pop("rate", None), asked.pop("mean_return", None)
    for name, value in asked.items():
        raise ConfigError(f"eval.solved.{name}={value}: expected rate or mean_return")
    for name, value in (("rate", rate), ("mean_return", mean_return)):
        if isinstance(value, bool) or not isinstance(value, int | float | None):
            raise ConfigError(f"eval.solved.{name}={value}: expected a number, or null")
    if rate is not None:
        positive("eval.solved.rate", rate)
        if rate > 1:
            raise ConfigError(f"eval.solved.rate={rate}: expected a share, at most 1")
    return Solved(rate, mean_return, config.eval.episodes)


def build_solved_rate(config: Settings) -> Solved:
    """The same for what is judged at checkpoints, which know no returns.  Raises ConfigError."""
    solved = build_solved(config)
    if solved.mean_return is not None:
        raise ConfigError(
            f"eval.solved.mean_return={solved.mean_return}: expected null without a search between"
            " trials; eval.solved.rate, with eval.success_return for episodes that are judged by"
            " their return"
        )
    return solved


def first_solved(history: Sequence[Checkpoint], solved: Solved) -> Checkpoint | None:
    """The first checkpoint at which the task counts as solved, None for never."""
    return next((point for point in history if solved.holds(point.success_rate)), None)


def checkpoint_solved(
    history: Sequence[Sequence[Checkpoint]], solved: Solved, seeds: Sequence[int]
) -> dict[str, Any]:
    """For ``summary.json``, from the checkpoints of each seed; nothing without a criterion."""
    if not solved.asked:
        return {}
    first = [first_solved(own, solved) for own in history]
    return {
        "seconds_to_solved": to_solved([point and point.seconds for point in first]),
        "trials_to_solved": to_solved([point and point.episodes for point in first]),
        "never_solved": [s for s, point in zip(seeds, first, strict=True) if point is None],
    }


def to_solved(values: Sequence[float | None]) -> dict[str, Any]:
    """Median and extremes with unsolved seeds, which are None, as infinity, which is null."""
    numbers = [math.inf if value is None else float(value) for value in values]
    return {
        "per_seed": [finite_or_null(value) for value in numbers],
        "median": finite_or_null(median_seconds(numbers)),
        "min": finite_or_null(min(numbers)),
        "max": finite_or_null(max(numbers)),
    }


def finite_or_null(value: float) -> float | None:
    """In a file: null for what is not finite, or not known as no episode counts as a success."""
    return value if math.isfinite(value) else None
