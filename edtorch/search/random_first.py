"""Random actions in the trials that a search begins with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edtorch.search.exploring import RandomActions
from edtorch.search.problem import SearchProblem
from edtorch.search.trial_lengths import TrialLengths


@dataclass(frozen=True)
class RandomFirst(TrialLengths):
    """random_size: share of the range of the actions that the first trials use; random_hold:
    seconds for which each of these lasts, None: a tick."""

    random_size: float = 1.0
    random_hold: float | None = None

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        super().__post_init__()
        if self.random_hold is not None and not self.random_hold > 0:
            raise ValueError(f"random_hold={self.random_hold}: expected a number > 0, or null")
        if not 0 < self.random_size <= 1:
            raise ValueError(f"random_size={self.random_size}: expected a number in (0, 1]")

    def explored(self, problem: SearchProblem, seeds: Sequence[int], number: int) -> RandomActions:
        """See ``TrialSearch``."""
        held = max(1, round((self.random_hold or problem.dt) / problem.dt))
        return RandomActions(problem.middle, self.random_size * problem.half, held)
