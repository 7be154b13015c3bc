"""Search by planning: Gauss-Newton trajectory optimisation on the learned model, and a choice among
the plans by their success under the uncertainty of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from edtorch.circle import wrapped
from edtorch.errors import NoPlan
from edtorch.model.mechanism import Structure
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.search.choice import PlanChoice, choose, futures_of
from edtorch.search.execution import Execution
from edtorch.search.ipopt import CASADI, reach_each
from edtorch.search.knowledge import Knowledge
from edtorch.search.noise_aware import noise_aware_gains
from edtorch.search.package import Package
from edtorch.search.plan import Cost, Plan, ramp
from edtorch.search.problem import Improvement, Left, SearchProblem, ticks_of
from edtorch.search.random_first import RandomFirst
from edtorch.search.segments import plan_through
from edtorch.search.starts import REST, lines, sinusoids, still
from edtorch.search.stationary import Stationary
from edtorch.search.target import distances, mean_start
from edtorch.search.tick_model import TickModel
from edtorch.search.timed import Timed
from edtorch.seeding import Purpose, numpy_generator
from edtorch.types import Parameters

EXECUTIONS: Mapping[str, Execution] = {"timed": Timed(), "stationary": Stationary()}


@dataclass(frozen=True)
class PlannedSearch(RandomFirst):
    """Plans from the mean start, by single shooting from ``starts`` sinusoidal actions and the last
    plans, and by multiple shooting from ``straight`` lines to the target and from ``programmed``
    paths to it (``edtorch.search.ipopt``, no more than there are choices of the directions in which
    the angles turn; from a line itself, with a note, where there is no path).

    policy: what executes a plan, ``timed`` (``edtorch.search.timed``) or ``stationary``, which
    goes on after it (``edtorch.search.stationary``).  horizon: seconds of a plan, None: of
    a trial.  ramp: seconds for which weights grow as (t / ramp)^power, and for which a plan is made
    first; it then goes on to its horizon in segments of constant weights.  None: the horizon.
    squash: see ``edtorch.search.plan.Cost``.

    gains: ``plain`` ones of the plan, those for noisy readings (``covariance``), or the better of
    ``both``.  keep: number of the cheapest plans that are simulated ``draws`` times each, in models
    drawn from the posterior, its deviations times ``inflation``; the one with the most successes is
    taken, the cheaper at a tie.  abort: scaled distance from the plan at which a trial is aborted,
    None: never.  substeps: of Runge and Kutta's method in a tick.  saltation: whether Jacobians
    through stops say how the time of a hit moves.
    """

    policy: Literal["timed", "stationary"] = "timed"
    horizon: float | None = None
    ramp: float | None = None
    power: float = 4.0
    squash: float = 1e-3
    starts: int = 8
    straight: int = 0
    programmed: int = 0
    gains: Literal["plain", "covariance", "both"] = "both"
    keep: int = 6
    draws: int = 100
    inflation: float = 2.0
    abort: float | None = 1.5
    substeps: int = 2
    saltation: bool = True

    figures = (
        *("transitions", "terms", "model_error", "plans", "dropped", "cost", "imagined"),
        *("largest_gain", "noise_aware"),
    )

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        super().__post_init__()
        counts = (("starts", 0), ("straight", 0), ("programmed", 0), ("keep", 1), ("draws", 1))
        for name, least in counts:
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"{name}={value}: expected an integer >= {least}")
        if not self.starts + self.straight + self.programmed:
            raise ValueError("starts=0, straight=0, programmed=0: expected one of them above 0")
        if self.policy not in EXECUTIONS:
            raise ValueError(f"policy={self.policy}: expected one of {', '.join(EXECUTIONS)}")
        if self.substeps < 1:
            raise ValueError(f"substeps={self.substeps}: expected an integer >= 1")
        for name in ("horizon", "ramp", "abort"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0, or null")
        for name in ("power", "squash", "inflation"):
            value = getattr(self, name)
            if not value >= 0:
                raise ValueError(f"{name}={value}: expected a number >= 0")

    @property
    def packages(self) -> Mapping[str, Package]:
        """See ``TrialLengths``."""
        return {f"programmed={self.programmed}": CASADI} if self.programmed else {}

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """See ``TrialSearch``."""
        horizon, _ = self._ticks(problem)
        return EXECUTIONS[self.policy].actor(problem, horizon)

    def left(self, problem: SearchProblem, parameters: Parameters) -> Left | None:
        """See ``TrialSearch``."""
        if self.abort is None:
            return None
        return EXECUTIONS[self.policy].left(problem, parameters, self.abort)

    def improve(
        self, problem: SearchProblem, knowledge: Knowledge, seed: int, trial: int
    ) -> Improvement:
        """See ``TrialSearch``."""
        learned = problem.learn(knowledge.transitions(problem.dt), knowledge.trial)
        structure = problem.structures[learned.name]
        model = problem.tick_model(learned, self.substeps, saltation=self.saltation)
        horizon, opening = self._ticks(problem)
        weight = ramp(problem.ticks, self.power, opening)
        whole = Cost(problem.rows, weight, problem.action, self.squash)
        cost = whole.part(0, horizon)
        starts = problem.starts(seed)
        generator = numpy_generator(seed, Purpose.PLAN, trial)
        plans, dropped, notes = self._plans(problem, model, cost, starts, knowledge, generator)
        if not plans:
            raise NoPlan(f"none of {dropped} starts led to a finite plan")
        noise = problem.noise_of(learned)
        candidates = self._candidates(problem, model, cost, plans, starts, noise)
        futures = futures_of(
            learned.posterior,
            starts,
            noise,
            problem.ticks,
            self.draws,
            self.inflation,
            numpy_generator(seed, Purpose.POSTERIOR, trial),
        )
        carried = EXECUTIONS[self.policy].carried(problem, model, whole, candidates, futures)
        chosen = choose([each.imagined for each in carried], problem.judge)
        plan, parameters = candidates[chosen.place], carried[chosen.place].parameters
        return Improvement(
            {name: torch.from_numpy(value) for name, value in parameters.items()},
            knowledge.with_plan({"raw": torch.from_numpy(plan.raw)}),
            {
                "transitions": float(learned.count),
                "terms": float(structure.terms.count),
                "model_error": learned.error,
                "plans": float(len(plans)),
                "dropped": float(dropped),
                "cost": plan.cost,
                "imagined": chosen.success,
                "largest_gain": float(np.abs(plan.gain).max()),
                "noise_aware": float(self._is_noise_aware(chosen.place, len(plans))),
            },
            learned.notes + notes + self._said(problem, structure, plan, chosen),
        )

    def _plans(
        self,
        problem: SearchProblem,
        model: TickModel,
        cost: Cost,
        starts: Tensor,
        knowledge: Knowledge,
        generator: np.random.Generator,
    ) -> tuple[list[Plan], int, tuple[str, ...]]:
        """Finite plans, the cheapest first, how many starts failed, and notes."""
        start, m = mean_start(starts, problem.period).numpy(), len(problem.half)
        horizon, first = self._ticks(problem)
        goal, dt = problem.goal[: horizon + 1].numpy(), problem.dt
        swings = sinusoids(start, first, m, dt, self.starts, generator)
        swings += [still(start, last["raw"].numpy()[:first]) for last in knowledge.plans]
        straight: list[Plan] = []
        while len(straight) < self.straight:
            straight += lines(model.structure, start, goal[first], first, m, dt, generator)
        linked, notes = straight[: self.straight], ()
        if self.programmed:
            direct = lines(model.structure, start, goal[first], first, m, dt, generator, wave=0.0)
            arrival = max(1, first - round(REST / dt))
            paths, notes = reach_each(model, direct[: self.programmed], arrival)
            linked += paths
        return *plan_through(model, cost, first, swings, linked, goal, self.keep), notes

    def _ticks(self, problem: SearchProblem) -> tuple[int, int]:
        """Of the horizon, and of the first segment.  Raises ValueError."""
        horizon = ticks_of("horizon", self.horizon, problem.ticks, problem.dt, "a trial")
        return horizon, ticks_of("ramp", self.ramp, horizon, problem.dt, "a plan")

    def _candidates(
        self,
        problem: SearchProblem,
        model: TickModel,
        cost: Cost,
        plans: Sequence[Plan],
        starts: Tensor,
        noise: Tensor,
    ) -> list[Plan]:
        """The plans with their own gains, then with noise-aware ones, as ``gains`` says."""
        if self.gains == "plain":
            return list(plans)
        away = wrapped(starts - mean_start(starts, problem.period), problem.period)
        start, reading = (away.mT @ away / len(away)).numpy(), noise.square().diag().numpy()
        aware = [noise_aware_gains(model, cost, plan, start, reading) for plan in plans]
        return aware if self.gains == "covariance" else [*plans, *aware]

    def _said(
        self, problem: SearchProblem, structure: Structure, plan: Plan, chosen: PlanChoice
    ) -> tuple[str, ...]:
        """How near the best plan comes, where none succeeded."""
        if chosen.success != 0:
            return ()
        last = len(plan.raw)
        end, goal = torch.from_numpy(plan.state[-1]), problem.goal[last]
        away = distances(structure, problem.rows[last], end, goal)
        words = (f"{problem.names[i]} {d * float(problem.scale[i]):.2g}" for i, d in away)
        return (
            f"no plan succeeded in any of {self.draws} imagined trials; after"
            f" {last * problem.dt:g} s the best is away from its target by {', '.join(words)}",
        )

    def _is_noise_aware(self, place: int, plans: int) -> bool:
        return self.gains == "covariance" or place >= plans
