"""The length of trials, and the random trials that a search begins with.  Protocol:
``edtorch.search.problem.TrialSearch``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from edtorch.search.package import Package
from edtorch.search.problem import Explored, SearchProblem


@dataclass(frozen=True)
class RandomFirst:
    """trial: seconds of a trial, None: a whole episode; random: of a random one, None: the same;
    random_trials: their number; random_size: share of the range of the actions that they use;
    random_hold: seconds for which each of these lasts, None: a tick."""

    trial: float | None = None
    random: float | None = None
    random_trials: int = 1
    random_size: float = 1.0
    random_hold: float | None = None

    models_strikes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        for name in ("trial", "random", "random_hold"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0, or null")
        if self.random_trials < 1:
            raise ValueError(f"random_trials={self.random_trials}: expected an integer >= 1")
        if not 0 < self.random_size <= 1:
            raise ValueError(f"random_size={self.random_size}: expected a number in (0, 1]")

    @property
    def prior(self) -> str:
        """Prior knowledge of the task beyond that of the state's components, in words."""
        return ""

    @property
    def packages(self) -> Mapping[str, Package]:
        """Those that it needs, by the setting that needs them."""
        return {}

    def runs(self, number: int) -> int:
        """How many runs the trial of this number has: one."""
        return 1

    def explored(
        self, problem: SearchProblem, seeds: Sequence[int], number: int
    ) -> Explored | None:
        """What is tried in the first trials: None, random actions."""
        return None
