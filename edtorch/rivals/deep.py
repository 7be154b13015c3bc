"""What the rivals of stable-baselines3 have in common that can be said without it."""

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass, field
from typing import ClassVar


@dataclass(frozen=True)
class Decisions:
    """How a world is put to an algorithm.

    copies: episodes side by side; repeat: ticks that an action lasts; failure_penalty: what a
    failure costs, in the unit of the shaping reward times a second; reward_scale: of the sum of
    both.
    """

    copies: int
    repeat: int
    failure_penalty: float
    reward_scale: float


@dataclass(frozen=True)
class DeepSettings:
    """steps: decisions before the first checkpoint; growth: each piece of work after that is so
    many times the one before, from 1 to 10; repeat: ticks that an action is held while it is
    learned from (a policy that is tried decides at every tick); failure_penalty: what a failure
    costs, in the unit of the shaping reward times a second; reward_scale: of all rewards;
    learning_rate, discount (per decision), hidden (units of each hidden layer): those of
    stable-baselines3, whose defaults everything else has.

    The reward of a decision is ``reward_scale`` times: the shaping reward, integrated over its
    ticks, less ``failure_penalty`` if it ends in a failure.  Under a negative shaping reward a
    failure ends all cost, and an agent without a penalty learns to fail.
    """

    steps: int
    growth: float = 1.0
    repeat: int = 1
    failure_penalty: float = 0.0
    reward_scale: float = 1.0
    learning_rate: float = 3e-4
    discount: float = 0.99
    hidden: list[int] = field(default_factory=list)
    takes_any_reward: ClassVar[bool] = True

    def piece(self, number: int) -> int:
        """Decisions of the piece of work with this number, from 0 on."""
        return round(self.steps * self.growth**number)

    def lesson(self, copies: int) -> Decisions:
        """How the world is put to so many copies of an episode."""
        return Decisions(copies, self.repeat, self.failure_penalty, self.reward_scale)

    def __post_init__(self) -> None:
        """Refuse impossible arguments; ModuleNotFoundError without stable-baselines3."""
        for name in ("steps", "repeat"):
            at_least_one(name, getattr(self, name))
        if not 1 <= self.growth <= 10:
            raise ValueError(f"growth={self.growth}: expected a number in [1, 10]")
        if not (math.isfinite(self.failure_penalty) and self.failure_penalty >= 0):
            raise ValueError(
                f"failure_penalty={self.failure_penalty}: expected a finite number, 0 or more"
            )
        for name in ("reward_scale", "learning_rate"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}={value}: expected a finite number > 0")
        if not 0 <= self.discount <= 1:
            raise ValueError(f"discount={self.discount}: expected a number in [0, 1]")
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"hidden={self.hidden}: expected units of each layer, 1 or more")
        if not is_installed():
            raise ModuleNotFoundError(
                f"{type(self).__name__} is stable-baselines3's, which is not installed; expected:"
                ' pip install "edtorch[rivals]"'
            )


def is_installed() -> bool:
    """Whether stable-baselines3 can be imported."""
    return importlib.util.find_spec("stable_baselines3") is not None


def at_least_one(name: str, value: int) -> None:
    """ValueError unless ``value`` is at least 1."""
    if value < 1:
        raise ValueError(f"{name}={value}: expected an integer >= 1")
