"""The policies that execute plans, each simulated before one is taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.search.imagination import Futures, Imagined
from edtorch.search.plan import Cost, Plan
from edtorch.search.problem import Left, SearchProblem
from edtorch.search.tick_model import TickModel
from edtorch.types import Parameters


@dataclass(frozen=True, eq=False)
class Carried:
    """A plan as a policy: its parameters, without a population axis, and their roll-outs in each
    future."""

    parameters: Mapping[str, np.ndarray]
    imagined: Imagined


class Execution(Protocol):
    """A kind of policy that executes plans."""

    def actor(self, problem: SearchProblem, ticks: int) -> tuple[Policy, EpisodeMemory | None]:
        """The policy for plans of so many ticks, and its memory if it has one.  Raises ValueError
        for a problem that it cannot solve."""
        ...

    def carried(
        self,
        problem: SearchProblem,
        model: TickModel,
        cost: Cost,
        plans: Sequence[Plan],
        futures: Futures,
    ) -> list[Carried]:
        """The policy of each plan; cost: over the trial.  Raises NoPlan where there is none."""
        ...

    def left(self, problem: SearchProblem, parameters: Parameters, limit: float) -> Left | None:
        """Whether a trial with these parameters ``[B, ...]`` has left its plan by a scaled distance
        of ``limit``; None where it has none to leave."""
        ...
