"""Search for one policy for all starts, by its gradient on the learned model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edtorch.errors import NoPlan
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.policy.squash import Squash
from edtorch.search.choice import choose, futures_of
from edtorch.search.families import MONOMIALS, PolicyFamily
from edtorch.search.gauss_newton import GAUSS_NEWTON
from edtorch.search.imagination import imagine_policies
from edtorch.search.improver import Improver, PolicyTask, side_by_side
from edtorch.search.knowledge import Knowledge
from edtorch.search.plan import Cost, ramp
from edtorch.search.problem import Improvement, Left, SearchProblem, ticks_of
from edtorch.search.random_first import RandomFirst
from edtorch.seeding import Purpose, numpy_generator
from edtorch.types import Parameters


@dataclass(frozen=True)
class GradientSearch(RandomFirst):
    """A stationary policy u = middle + half tanh(z(s)), z of the lift of the state: where starts
    are spread wide, one plan does not do.

    policy: the kind of z (``edtorch.search.families``).  odd: z(-s) = -z(s), for a system
    with mirror symmetry; this counts as prior knowledge, too.

    Its cost from ``starts`` starts over ``horizon`` seconds (None: an episode), or its expectation
    under a belief, is lowered by the ``improver`` (``edtorch.search.gauss_newton``,
    ``edtorch.search.adam``) from ``restarts`` random policies whose parameters have the deviation
    ``spread``, over a horizon that grows, and from the last policies.  The policy is taken that
    does best in imagination, as in ``edtorch.search.planned.PlannedSearch``, whose settings
    ``power``, ``squash``, ``draws``, ``inflation`` and ``substeps`` are.
    """

    policy: PolicyFamily = MONOMIALS
    improver: Improver = GAUSS_NEWTON
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
        for name in ("starts", "restarts", "draws", "substeps"):
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
        """See ``TrialLengths``."""
        return "the policy is odd" if self.odd else ""

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """See ``TrialSearch``.  ValueError for a reward with a reference, which no stationary
        policy follows."""
        problem.check_constant("search=gradient")
        self._ticks(problem)
        policy = self._policy(problem)
        self.improver.check(policy)
        return policy, None

    def left(self, problem: SearchProblem, parameters: Parameters) -> Left | None:
        """See ``TrialSearch``: never."""
        return None

    def improve(
        self, problem: SearchProblem, knowledge: Knowledge, seed: int, trial: int
    ) -> Improvement:
        """See ``TrialSearch``."""
        learned = problem.learn(knowledge.transitions(problem.dt), knowledge.trial)
        model = problem.tick_model(learned, self.substeps)
        policy, starts = self._policy(problem), problem.starts(seed)
        noise = problem.noise_of(learned)
        task = PolicyTask(
            model=model,
            cov=self.inflation**2 * learned.posterior.cov,
            policy=policy,
            cost=lambda ticks: self._cost(problem, ticks),
            ticks=self._ticks(problem),
            starts=starts[: self.starts],
            seen=starts,
            reading=noise,
            period=problem.period,
        )
        generator = numpy_generator(seed, Purpose.PLAN, trial)
        fresh = policy.random(self.restarts, self.spread, generator)
        found = self.improver.improve(task, fresh, _stacked(knowledge, fresh))
        candidates, tried = found.finite, len(found.cost)
        if not len(candidates.cost):
            raise NoPlan(f"none of {tried} policies has a finite cost")
        futures = futures_of(
            learned.posterior,
            starts,
            noise,
            problem.ticks,
            self.draws,
            self.inflation,
            numpy_generator(seed, Purpose.POSTERIOR, trial),
        )
        whole = Cost(problem.rows, ramp(problem.ticks, 0.0), problem.action, self.squash)
        imagined = imagine_policies(model, whole, policy, candidates.parameters, futures)
        chosen = choose(imagined, problem.judge)
        parameters = {name: p[chosen.place] for name, p in candidates.parameters.items()}
        return Improvement(
            parameters,
            knowledge.with_plan(parameters),
            {
                "transitions": float(learned.count),
                "terms": float(model.structure.terms.count),
                "model_error": learned.error,
                "policies": float(len(candidates.cost)),
                "dropped": float(tried - len(candidates.cost)),
                "cost": float(candidates.cost[chosen.place]),
                "imagined": chosen.success,
                "imagined_cost": chosen.cost,
                "largest_weight": max(float(p.abs().max()) for p in parameters.values()),
            },
            learned.notes,
        )

    def _cost(self, problem: SearchProblem, ticks: int) -> Cost:
        weight = ramp(ticks, self.power)
        return Cost(problem.rows[: ticks + 1], weight, problem.action, self.squash)

    def _ticks(self, problem: SearchProblem) -> int:
        return ticks_of("horizon", self.horizon, problem.ticks, problem.dt, "an episode")

    def _policy(self, problem: SearchProblem) -> BoundedPolicy:
        """Of the components that the dynamics or the reward depend on."""
        lift = next(iter(problem.structures.values())).lift
        acts = (problem.rows[0] != 0).any(0)
        for structure in problem.structures.values():
            acts[structure.terms.factors] = True
        last = lift.at + lift.angle
        acting = np.flatnonzero(acts[lift.at] | acts[last])
        squash = Squash(problem.middle, problem.half)
        return self.policy.policy(lift, acting.tolist(), squash, odd=self.odd)


def _stacked(knowledge: Knowledge, like: Parameters) -> Parameters:
    """The last policies, ``[W, ...]``."""
    none = {name: p[:0] for name, p in like.items()}
    each = [{name: p.unsqueeze(0) for name, p in plan.items()} for plan in knowledge.plans]
    return side_by_side(none, *each)
