"""How plans are carried out: by policies that are imagined before one is taken."""

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
    """A plan made a policy: its parameters, without a population axis, and what they came to in
    each future."""

    parameters: Mapping[str, np.ndarray]
    imagined: Imagined


class Execution(Protocol):
    """A kind of policy that plans lead to."""

    def actor(self, problem: SearchProblem, ticks: int) -> tuple[Policy, EpisodeMemory | None]:
        """Who acts by plans of so many ticks, and what goes with it.  Raises ValueError where that
        cannot be."""
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
        """Whether a trial by these parameters ``[B, ...]`` has left its plan by a scaled distance
        of ``limit``; None where it has none to leave."""
        ...
