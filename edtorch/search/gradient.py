"""Search for one policy for all starts, by its gradient on the learned model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import NoPlan
from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.policy.lifted import LiftedPolicy
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.policy.squash import Squash
from edtorch.search.choice import choose, futures_of
from edtorch.search.imagination import imagine_lifted
from edtorch.search.knowledge import Knowledge
from edtorch.search.plan import Cost, ramp
from edtorch.search.policy_descent import Weighted, descend
from edtorch.search.problem import Improvement, Left, SearchProblem, ticks_of
from edtorch.search.random_first import RandomFirst
from edtorch.search.tick_model import TickModel
from edtorch.seeding import Purpose, numpy_generator
from edtorch.types import Parameters

GROWTH = (0.25, 0.5, 0.75, 1.0)
"""Shares of the horizon, one after the other: what a policy does later depends on what it does
first, and the cost over a long horizon has many poor local optima; over a very short one greedy
policies are best."""


@dataclass(frozen=True)
class GradientSearch(RandomFirst):
    """A stationary policy u = middle + half tanh(theta . phi(s)), phi the monomials of the lift up
    to ``degree`` (``edtorch.policy.lifted``): where starts are spread wide, one plan does not do.
    odd: only the monomials that change sign with the state, for a system with mirror symmetry; this
    counts as prior knowledge, too.

    Its cost from ``starts`` starts over ``horizon`` seconds (None: an episode) is lowered
    (``edtorch.search.policy_descent``) from ``restarts`` random theta of deviation ``spread``, over
    a horizon that grows, and from the last policies.  The policy is taken that does best in
    imagination, as in ``edtorch.search.planned.PlannedSearch``, whose settings ``power``,
    ``squash``, ``draws``, ``inflation`` and ``substeps`` are.
    """

    degree: int = 3
    odd: bool = False
    horizon: float | None = None
    power: float = 0.5
    squash: float = 1e-3
    starts: int = 24
    restarts: int = 6
    spread: float = 1.0
    draws: int = 50
    inflation: float = 2.0
    substeps: int = 2

    figures = (
        *("transitions", "terms", "model_error", "policies", "dropped", "cost", "imagined"),
        *("imagined_cost", "largest_weight"),
    )

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        super().__post_init__()
        for name in ("degree", "starts", "restarts", "draws", "substeps"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name}={value}: expected an integer >= 1")
        if self.horizon is not None and not self.horizon > 0:
            raise ValueError(f"horizon={self.horizon}: expected a number > 0, or null")
        for name in ("power", "squash", "spread", "inflation"):
            value = getattr(self, name)
            if not value >= 0:
                raise ValueError(f"{name}={value}: expected a number >= 0")

    @property
    def prior(self) -> str:
        """See ``RandomFirst``."""
        return "the policy is odd" if self.odd else ""

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """See ``TrialSearch``.  ValueError for a reward with a reference, which no stationary
        policy follows."""
        problem.check_constant("gradient")
        self._ticks(problem)
        squash = Squash(problem.middle, problem.half)
        return LiftedPolicy(_lift(problem), self._terms(problem), squash), None

    def left(self, problem: SearchProblem, parameters: Parameters) -> Left | None:
        """See ``TrialSearch``: never."""
        return None

    def improve(
        self, problem: SearchProblem, knowledge: Knowledge, seed: int, trial: int
    ) -> Improvement:
        """See ``TrialSearch``."""
        learned = problem.learn(knowledge.transitions(problem.dt), knowledge.trial)
        structure = problem.structures[learned.name]
        model = problem.tick_model(learned, self.substeps)
        starts = problem.starts(seed)
        found = self._policies(problem, model, starts[: self.starts], knowledge, seed, trial)
        finite = [policy for policy in found if np.isfinite(policy.cost)]
        if not finite:
            raise NoPlan(f"none of {len(found)} policies has a finite cost")
        futures = futures_of(
            learned.posterior,
            starts,
            problem.noise_of(learned),
            problem.ticks,
            self.draws,
            self.inflation,
            numpy_generator(seed, Purpose.POSTERIOR, trial),
        )
        whole = Cost(problem.rows, ramp(problem.ticks, 0.0), problem.action, self.squash)
        imagined = [imagine_lifted(model, whole, policy, futures) for policy in finite]
        chosen = choose(imagined, problem.judge)
        policy = finite[chosen.place]
        weight = torch.from_numpy(policy.weight)
        return Improvement(
            {"weight": weight},
            knowledge.with_plan(weight),
            {
                "transitions": float(learned.count),
                "terms": float(structure.terms.count),
                "model_error": learned.error,
                "policies": float(len(finite)),
                "dropped": float(len(found) - len(finite)),
                "cost": policy.cost,
                "imagined": chosen.success,
                "imagined_cost": chosen.cost,
                "largest_weight": float(weight.abs().max()),
            },
            learned.notes,
        )

    def _policies(
        self,
        problem: SearchProblem,
        model: TickModel,
        starts: Tensor,
        knowledge: Knowledge,
        seed: int,
        trial: int,
    ) -> list[Weighted]:
        """One from each random theta, then from each of the last policies."""
        terms, horizon = self._terms(problem), self._ticks(problem)
        generator, start = numpy_generator(seed, Purpose.PLAN, trial), starts.numpy()
        shape = (len(problem.half), terms.count)
        found = []
        for _ in range(self.restarts):
            policy = Weighted(terms, self.spread * generator.standard_normal(shape))
            for share in GROWTH:
                cost = self._cost(problem, max(1, round(share * horizon)))
                policy = descend(model, cost, policy, start)
            found.append(policy)
        cost = self._cost(problem, horizon)
        warm = [Weighted(terms, weight.numpy()) for weight in knowledge.plans]
        return found + [descend(model, cost, policy, start) for policy in warm]

    def _cost(self, problem: SearchProblem, ticks: int) -> Cost:
        weight = ramp(ticks, self.power)
        return Cost(problem.rows[: ticks + 1], weight, problem.action, self.squash)

    def _ticks(self, problem: SearchProblem) -> int:
        return ticks_of("horizon", self.horizon, problem.ticks, problem.dt, "an episode")

    def _terms(self, problem: SearchProblem) -> Terms:
        """Of the components that the dynamics or the reward depend on."""
        lift = _lift(problem)
        acts = (problem.rows[0] != 0).any(0)
        for structure in problem.structures.values():
            acts[structure.terms.factors] = True
        last = lift.at + lift.angle
        acting = np.flatnonzero(acts[lift.at] | acts[last])
        return Terms.of_state(lift, acting.tolist(), self.degree, odd=self.odd)


def _lift(problem: SearchProblem) -> Lift:
    return next(iter(problem.structures.values())).lift
