"""Where the search of one seed stands, from trial to trial."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from edtorch.report.experience import SeedExperience
from edtorch.search.knowledge import Knowledge
from edtorch.search.problem import Improvement


@dataclass
class SeedProgress:
    """planned: whether it has a policy; seconds: of experience; trials: done; after each of them
    seconds_after and the rates of success; solved, solved_trials: seconds and trials when its task
    first counted as solved, None for not yet; cpu_s: of learning from each trial."""

    knowledge: Knowledge = field(default_factory=Knowledge)
    planned: bool = False
    seconds: float = 0.0
    trials: int = 0
    solved: float | None = None
    solved_trials: int | None = None
    seconds_after: list[float] = field(default_factory=list)
    rates: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)

    def learned(self, found: Improvement, cpu_s: float, seconds: float) -> None:
        """Take what was found after so many seconds of experience more."""
        self.cpu_s.append(cpu_s)
        self.knowledge = found.knowledge
        self.planned |= bool(found.parameters)
        self.seconds += seconds

    def judged(self, rate: float, solves: bool) -> None:
        """Take the success rate of the policy that it has now; solves: whether the task counts as
        solved by it."""
        self.rates.append(rate)
        self.seconds_after.append(self.seconds)
        if solves:
            self.solved, self.solved_trials = self.seconds, self.trials

    @property
    def experience(self) -> SeedExperience:
        """For the figure."""
        solved = math.inf if self.solved is None else self.solved
        return SeedExperience(self.seconds_after, self.rates, solved)

    def state(self) -> dict[str, Any]:
        """For ``edtorch.run.state_file``."""
        return {**vars(self), "knowledge": self.knowledge.state()}

    @classmethod
    def of_state(cls, state: Mapping[str, Any]) -> SeedProgress:
        """From such a state."""
        return cls(**{**state, "knowledge": Knowledge.of_state(state["knowledge"])})
