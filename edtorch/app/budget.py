"""From the group ``train`` to a budget."""

from __future__ import annotations

from typing import Any

from edtorch.app.checks import at_least, positive
from edtorch.app.errors import ConfigError
from edtorch.run.episodes import Budget


def given_budget(config: Any) -> Budget | None:
    """What a learner may use, None where there is no limit.  Raises ConfigError."""
    if config.seconds is not None:
        positive("train.seconds", config.seconds)
    for name in ("episodes", "successes"):
        if config[name] is not None:
            at_least(f"train.{name}", config[name], 1)
    if config.seconds is None and config.episodes is None and config.successes is None:
        return None
    return Budget(config.seconds, config.episodes, config.successes)


def build_budget(config: Any) -> Budget:
    """What a learner may use, where there must be a limit.  Raises ConfigError."""
    budget = given_budget(config)
    if budget is None:
        raise ConfigError(
            "train.seconds=null, train.episodes=null, train.successes=null: expected a number for"
            " one of them"
        )
    return budget


def check_ticks(budget: Budget, dt: float) -> None:
    """Refuse a budget that ends before the first tick, of ``dt`` seconds.  Raises ConfigError."""
    if budget.seconds is not None and budget.seconds < dt * (1 - 1e-9):
        raise ConfigError(
            f"train.seconds={budget.seconds:g}: expected at least one tick of the domain, {dt:g} s"
        )
