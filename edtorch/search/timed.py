"""Plans executed tick by tick."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from edtorch.circle import wrapped
from edtorch.policy.clock import EpisodeClock
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.policy.squash import Squash
from edtorch.policy.timed import TimedPolicy
from edtorch.search.execution import Carried
from edtorch.search.imagination import Futures, imagine
from edtorch.search.plan import Cost, Plan
from edtorch.search.problem import Left, SearchProblem
from edtorch.search.tick_model import TickModel
from edtorch.types import Parameters


class Timed:
    """A policy with the plan's own gains at each tick (``edtorch.policy.timed``)."""

    def actor(self, problem: SearchProblem, ticks: int) -> tuple[Policy, EpisodeMemory | None]:
        """See ``Execution``: with a clock."""
        if ticks != problem.ticks:
            raise ValueError(
                f"horizon={problem.dt * ticks:g}: expected the length of a trial,"
                f" {problem.dt * problem.ticks:g} s, with policy=timed; policy=stationary goes on"
                " after a plan"
            )
        squash = Squash(problem.middle, problem.half)
        return TimedPolicy(ticks, squash, problem.period), EpisodeClock()

    def carried(
        self,
        problem: SearchProblem,
        model: TickModel,
        cost: Cost,
        plans: Sequence[Plan],
        futures: Futures,
    ) -> list[Carried]:
        """See ``Execution``."""
        return [
            Carried(
                {"state": plan.state, "raw": plan.raw, "gain": plan.gain},
                imagine(model, cost, plan, futures),
            )
            for plan in plans
        ]

    def left(self, problem: SearchProblem, parameters: Parameters, limit: float) -> Left | None:
        """See ``Execution``."""
        planned = parameters["state"]

        def left(tick: int, readings: Tensor) -> Tensor:
            at = min(tick, planned.shape[1] - 1)
            return wrapped(readings - planned[:, at], problem.period).norm(dim=-1) > limit

        return left
