"""The length and the number of trials, and what most searches between trials have in common.
Protocol: ``edtorch.search.problem.TrialSearch``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from edtorch.search.package import Package


@dataclass(frozen=True)
class TrialLengths:
    """trial: seconds of a trial, None: a whole episode; random: of one of the first, None: the
    same; random_trials: the number of those."""

    trial: float | None = None
    random: float | None = None
    random_trials: int = 1

    models_strikes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        for name in ("trial", "random"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0, or null")
        if self.random_trials < 1:
            raise ValueError(f"random_trials={self.random_trials}: expected an integer >= 1")

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
