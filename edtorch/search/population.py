"""Search for a gait by a population: what walks best in imagination, in a learned model with stops
and strikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import NoPlan, within
from edtorch.model.event_free import free_ticks
from edtorch.model.lift import Lift
from edtorch.model.stops import Stops
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.policy.squash import Squash
from edtorch.policy.vector import Gait, VectorPolicy
from edtorch.rewards.lifted import lifted_row
from edtorch.search.choice import futures_of
from edtorch.search.evolution import Evolution
from edtorch.search.exploring import Perturbed
from edtorch.search.ground import NO_GROUND, fit_ground
from edtorch.search.hybrid_fit import LearnedHybrid
from edtorch.search.knowledge import Knowledge
from edtorch.search.package import Package
from edtorch.search.phase_runs import PhaseRuns, RunEnds, phase_runs
from edtorch.search.problem import Improvement, Left, SearchProblem
from edtorch.search.trial_lengths import TrialLengths
from edtorch.search.vector_search import BegunSearch, VectorSearch
from edtorch.seeding import Purpose, numpy_generator
from edtorch.types import Parameters


@dataclass(frozen=True)
class RunStage:
    """At most ``policies``, rounded up to whole generations, until half of one scores ``enough``;
    each policy is tried from ``long`` starts for ``seconds`` and from ``short`` starts for
    ``short_seconds``; friction: that the ground is held to have, None for any; push: deviation of
    noise added to the actions, in parts of half their range; doubt: each start has a model of its
    own, drawn from the posterior with its deviations times this; reading: whether readings err."""

    policies: int
    enough: float
    long: int
    seconds: float
    short: int
    short_seconds: float
    friction: float | None
    push: float
    doubt: float
    reading: bool

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        for name, least in (("policies", 1), ("long", 1), ("short", 0)):
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"{name}={value}: expected an integer >= {least}")
        if not 0 <= self.enough <= 1:
            raise ValueError(f"enough={self.enough}: expected a number in [0, 1], a score")
        for name in ("short_seconds", "push", "doubt"):
            value = getattr(self, name)
            if not value >= 0:
                raise ValueError(f"{name}={value}: expected a number >= 0")
        for name in ("seconds", *(["short_seconds"] if self.short else [])):
            value = getattr(self, name)
            if not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0 (s)")
        if self.friction is not None and not self.friction > 0:
            raise ValueError(f"friction={self.friction}: expected a number > 0, or null for any")


CHECKED, LASTING = 4, 0.97
"""Times the runs of a generation; the share of them that is to last."""

ROUGH = RunStage(640, 0.9, 2, 3.0, 0, 0.0, None, 0.0, 0.0, False)
FINE = RunStage(640, 0.9, 3, 5.0, 13, 1.5, 0.6, 0.05, 0.0, False)
FIRM = RunStage(320, 0.95, 3, 5.0, 13, 1.5, 0.6, 0.1, 0.0, False)


@dataclass(frozen=True)
class PopulationSearch(TrialLengths):
    """A policy by a phase (``edtorch.policy.phase``), or another one of that kind, in imagined runs
    that begin at starts that were seen.

    A run scores the share of its time before it ended, or of ``cadence`` strikes per second where
    it made fewer: a gait with quick steps that soon falls is not better than one that lasts.  A
    policy scores the mean of its runs and half the worst, 1 at most.

    ``optimiser`` moves a population through the stages ``rough``, ``fine`` and ``firm``, with other
    starts and noise in every generation.  Its mean is the policy: where its neighbours walk, too,
    it may walk in a world that differs from the model.  It begins at the last policy,
    with the gait's deviations times ``narrow``, or at the gait as it is told.  Where it does not
    pass ``rough``, or too many runs of ``fine`` with its mean end early, another one begins at the
    gait as it is told, ``attempts`` at most; the best mean is taken.

    The first trial is ``first_runs`` runs with parameters drawn by the gait's deviations and noise
    of deviation ``noise``, in parts of half the range; a later one ``later_runs`` runs.

    always, landed: rows of the lift, by name in physical units as a reward's (``reward=lifted``),
    that stay above zero until a run ends, and just after a strike.  forward, up: components that
    read the force of the ground, of which both are learned; None: nothing slips.
    """

    gait: Gait = field(kw_only=True)
    first_runs: int = 40
    later_runs: int = 4
    noise: float = 0.2
    attempts: int = 3
    optimiser: VectorSearch = field(default_factory=Evolution)
    narrow: float = 0.3
    cadence: float = 1.0
    always: Sequence[Mapping[str, float]] = ()
    landed: Sequence[Mapping[str, float]] = ()
    forward: str | None = None
    up: str | None = None
    rough: RunStage = ROUGH
    fine: RunStage = FINE
    firm: RunStage = FIRM
    substeps: int = 1

    models_strikes: ClassVar[bool] = True
    figures = (
        *("transitions", "free", "strikes", "force_error", "policies", "imagined_strikes"),
        *("imagined", "score"),
    )

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        super().__post_init__()
        for name in ("first_runs", "later_runs", "attempts", "substeps"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name}={value}: expected an integer >= 1")
        for name in ("cadence", "narrow"):
            value = getattr(self, name)
            if not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0")
        if not self.noise >= 0:
            raise ValueError(f"noise={self.noise}: expected a number >= 0")
        for name in ("gait", "optimiser", "rough", "fine", "firm"):
            if getattr(self, name) is None:
                raise ValueError(f"{name}=null: expected a part, as in conf/search/population.yaml")
        if (self.forward is None) != (self.up is None):
            raise ValueError(
                f"forward={self.forward}, up={self.up}: expected names of both or null for both"
            )

    @property
    def prior(self) -> str:
        """See ``TrialLengths``."""
        told = [self.gait.words, f"{self.cadence:g} strikes/s"]
        told += [f"{_words(row)} > 0" for row in self.always]
        told += [f"after a strike {_words(row)} > 0" for row in self.landed]
        return "; ".join(told)

    @property
    def packages(self) -> Mapping[str, Package]:
        """See ``TrialLengths``."""
        package = self.optimiser.package
        return {} if package is None else {"optimiser": package}

    def runs(self, number: int) -> int:
        """See ``TrialLengths``."""
        return self.first_runs if number < self.random_trials else self.later_runs

    def explored(self, problem: SearchProblem, seeds: Sequence[int], number: int) -> Perturbed:
        """See ``TrialSearch``: about the gait as it is told."""
        policy, runs = self._policy(problem), self.runs(number)
        generators = [numpy_generator(seed, Purpose.EXPLORING, number) for seed in seeds]
        drawn = [policy.random(runs, 1.0, generator) for generator in generators]
        parameters = {name: torch.cat([own[name] for own in drawn]) for name in drawn[0]}
        return Perturbed(policy, parameters, self.noise * problem.half)

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """See ``TrialSearch``.  ValueError for a task without strikes, and for unknown names."""
        if problem.hybrid is None:
            raise ValueError("search=population: expected a strike that is told (told.strike)")
        self._ends(problem)
        self._forces(problem)
        return self._policy(problem), None

    def left(self, problem: SearchProblem, parameters: Parameters) -> Left | None:
        """See ``TrialSearch``: never."""
        return None

    def improve(
        self, problem: SearchProblem, knowledge: Knowledge, seed: int, trial: int
    ) -> Improvement:
        """See ``TrialSearch``."""
        assert problem.hybrid is not None and problem.noise is not None
        transitions = knowledge.transitions(problem.dt)
        # The last tick of a run may be that of a fall, in which the simulator stops all motion.
        last = torch.tensor([len(own) for own in knowledge.actions]).cumsum(0) - 1
        transitions.valid[last] = False
        learned = problem.hybrid(transitions, self.substeps)
        ends, forces = self._ends(problem), self._forces(problem)
        if forces is not None:
            known = learned.model
            stops = known.free.stops or Stops.none(len(problem.names))
            free = free_ticks(transitions, stops, known.strike, problem.noise)
            calm = replace(transitions, valid=free)
            force = fit_ground(known.free.structure, calm, forces, problem.scale)
            ends = replace(ends, ground=force)
        policy = self._policy(problem)
        generator = numpy_generator(seed, Purpose.PLAN, trial)
        imagined = _Imagined(problem, learned, policy, ends, problem.starts(seed), self.cadence)
        told, deviation = (part.numpy() for part in policy.begun)
        begins = [(policy.vector(plan).numpy(), self.narrow) for plan in knowledge.plans[:1]]
        begins += [(told, 1.0)] * (self.attempts - len(begins))
        found: list[_Found] = []
        tried = 0
        for begin, spread in begins:
            population = self.optimiser.begun(begin, deviation, spread, _seed(generator))
            passed, policies = self._grown(population, imagined, generator)
            tried += policies
            if passed:
                found.append(self._checked(population.mean, imagined, generator))
                if found[-1].lasted >= LASTING:
                    break
        if not found:
            raise NoPlan(f"no gait of {tried} lasts for {self.rough.seconds:g} s in imagination")
        best = max(found, key=lambda each: each.score)
        parameters = policy.of_vector(torch.from_numpy(best.vector))
        return Improvement(
            parameters,
            knowledge.with_plan(parameters),
            {
                "transitions": float(transitions.valid.sum()),
                "free": float(learned.free),
                "strikes": float(learned.strikes),
                "force_error": float(ends.ground.error[1]),
                "policies": float(tried),
                "imagined_strikes": best.strikes,
                "imagined": best.lasted,
                "score": best.score,
            },
        )

    def _grown(
        self, population: BegunSearch, imagined: _Imagined, generator: np.random.Generator
    ) -> tuple[bool, int]:
        """Through the stages: whether it passed ``rough``, and how many policies were tried."""
        tried = 0
        for stage in (self.rough, self.fine, self.firm):
            half, left = -np.inf, stage.policies
            while left > 0 and half < stage.enough:
                cost = partial(imagined.cost, stage=stage, seed=_seed(generator))
                costs = population.improve(cost)
                half, left, tried = -np.median(costs), left - len(costs), tried + len(costs)
            if stage is self.rough and half < stage.enough:
                return False, tried
        return True, tried

    def _checked(
        self, vector: np.ndarray, imagined: _Imagined, generator: np.random.Generator
    ) -> _Found:
        """In runs of ``fine``, more of them than those of a generation."""
        stage = replace(self.fine, long=CHECKED * self.fine.long, short=CHECKED * self.fine.short)
        runs = imagined.runs(vector[None], stage, _seed(generator))
        return _Found(
            vector,
            score=float(imagined.score(runs, stage)[0]),
            lasted=float((runs.ticks == imagined.lengths(stage)).mean()),
            strikes=float(runs.strikes[0, : stage.long].mean()),
        )

    def _policy(self, problem: SearchProblem) -> VectorPolicy:
        with within("gait"):
            return self.gait.policy(problem.told, Squash(problem.middle, problem.half))

    def _ends(self, problem: SearchProblem) -> RunEnds:
        lift = Lift.of(problem.told)

        def rows(named: Sequence[Mapping[str, float]], key: str) -> np.ndarray:
            found = [lifted_row(lift, row, f"{key}[{k}]").numpy() for k, row in enumerate(named)]
            return np.array(found).reshape(len(found), lift.size)

        return RunEnds(rows(self.always, "always"), rows(self.landed, "landed"), NO_GROUND)

    def _forces(self, problem: SearchProblem) -> tuple[int, int] | None:
        if self.forward is None or self.up is None:
            return None
        for key, name in (("forward", self.forward), ("up", self.up)):
            if name not in problem.names:
                known = ", ".join(problem.names)
                raise ValueError(f"{key}={name}: expected one of {known}")
        return problem.names.index(self.forward), problem.names.index(self.up)


@dataclass(frozen=True, eq=False)
class _Found:
    """A policy ``[p]``, its score, the share of its runs that lasted, and the mean strikes of long
    ones."""

    vector: np.ndarray
    score: float
    lasted: float
    strikes: float


class _Imagined:
    """Runs of policies in one model: starts and noise are the same for all of a generation."""

    def __init__(
        self,
        problem: SearchProblem,
        learned: LearnedHybrid,
        policy: VectorPolicy,
        ends: RunEnds,
        starts: Tensor,
        cadence: float,
    ) -> None:
        assert problem.noise is not None
        self._learned, self._policy, self._ends = learned, policy, ends
        self._dt, self._half, self._noise = problem.dt, problem.half.numpy(), problem.noise
        self._starts, self._cadence = starts, cadence

    def lengths(self, stage: RunStage) -> np.ndarray:
        """Ticks ``[P]`` of the runs of a stage."""
        each = [(stage.seconds, stage.long), (stage.short_seconds, stage.short)]
        return np.repeat([round(s / self._dt) for s, _ in each], [count for _, count in each])

    def runs(self, vectors: np.ndarray, stage: RunStage, seed: int) -> PhaseRuns:
        """Of policies ``[C, p]``."""
        generator, length = np.random.default_rng(seed), self.lengths(stage)
        futures = futures_of(
            self._learned.posterior,
            self._starts,
            self._noise * stage.reading,
            int(length.max()),
            len(length),
            stage.doubt,
            generator,
        )
        push = self._half * stage.push
        push = push * generator.standard_normal((len(length), length.max(), len(self._half)))
        push[np.arange(length.max()) >= length[:, None]] = np.nan
        friction = np.inf if stage.friction is None else stage.friction
        ends = replace(self._ends, friction=friction)
        model = self._learned.model
        return phase_runs(model, self._policy, vectors, futures, push, ends)

    def cost(self, vectors: np.ndarray, stage: RunStage, seed: int) -> np.ndarray:
        """Minus the scores ``[C]`` of policies ``[C, p]``."""
        return -self.score(self.runs(vectors, stage, seed), stage)

    def score(self, runs: PhaseRuns, stage: RunStage) -> np.ndarray:
        """``[C]``, of ``PopulationSearch``."""
        share = runs.shares(self.lengths(stage), self._cadence * self._dt)
        return (share.mean(1) + 0.5 * share.min(1)) / 1.5


def _seed(generator: np.random.Generator) -> int:
    return int(generator.integers(2**31))


def _words(row: Mapping[str, float]) -> str:
    return " + ".join(f"{value:g} {name}" for name, value in row.items())
