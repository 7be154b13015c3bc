"""The loop between a population of learners and their worlds.

Nothing here writes or prints: whoever runs the loop asks it for snapshots and records.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.learner import Check, Learner
from edtorch.streams import Draw, Purpose, Streams, stream_key
from edtorch.trail import Trail
from edtorch.types import (
    LearnerState,
    Metrics,
    Transition,
    replace,
    select,
    tree_dataclass,
)
from edtorch.world import World
from sims.base import Outcome

RIDES = (Outcome.SUCCEEDED, Outcome.TIMED_OUT)
"""A ride: the goal was reached, or the time limit without a failure."""


@dataclass(frozen=True)
class Budget:
    """What a learner may use; whichever ends first ends it.  None: unlimited.

    seconds: simulated; episodes: ended in any way; rides: see ``RIDES``.
    """

    seconds: float | None = None
    episodes: int | None = None
    rides: int | None = None

    def __post_init__(self) -> None:
        if self.seconds is None and self.episodes is None and self.rides is None:
            raise ValueError("no budget: give seconds, episodes or rides")


@dataclass(frozen=True)
class Episode:
    """One finished episode of one learner (or of one evaluated policy).

    row: the learner's place in the population; start: simulated seconds of learning before it;
    seconds: its length; measures: the sim's own figures of it; trail: first and last index
    (exclusive) of its states in the ``Trail``.
    """

    row: int
    number: int
    start: float
    seconds: float
    outcome: Outcome
    measures: dict[str, float]
    trail: tuple[int, int] = (0, 0)

    @property
    def is_ride(self) -> bool:
        """Whether it counts as a ride."""
        return self.outcome in RIDES


@tree_dataclass
class Experience:
    """Where each learner of a population stands in its world; everything ``[B, ...]``.

    world, start: the sim's state now and at the start of the episode; observation: scaled;
    begun: tick at which the episode began; active: still learning; counters of finished episodes.
    """

    world: Tensor
    start: Tensor
    observation: Tensor
    begun: Tensor
    active: Tensor
    episodes: Tensor
    falls: Tensor
    rides: Tensor


@dataclass(frozen=True)
class Snapshot:
    """The population at one moment, per learner; value, gradient and error are means since the
    snapshot before (NaN for a learner that did not learn in between).  value_error: the value error
    estimate, where it was asked for."""

    seconds: float
    seeds: list[int]
    active: list[bool]
    episodes: list[int]
    falls: list[int]
    rides: list[int]
    episode_seconds: list[float]
    value: list[float]
    gradient: list[float]
    error: list[float]
    policy_norm: list[float]
    value_error: list[float] | None = None


@dataclass
class _Sums:
    """Sums of the metrics since the last snapshot."""

    value: Tensor
    gradient: Tensor
    error: Tensor
    ticks: Tensor

    @staticmethod
    def zero(size: int) -> _Sums:
        return _Sums(*(torch.zeros(size, dtype=torch.float64) for _ in range(4)))

    def add(self, metrics: Metrics, active: Tensor) -> None:
        self.value.addcmul_(metrics.value, active)
        self.gradient.addcmul_(metrics.gradient, active)
        self.error.addcmul_(metrics.error, active)
        self.ticks += active


class Training:
    """A population of learners, each in its own world, learning in lockstep.

    seeds: one per learner; learner k draws from the stream of its seed alone, so that it does the
    same in any population.  ``advance`` runs ticks; ``learners``, ``worlds`` and ``clock`` are the
    whole state (``edtorch.checkpoint`` saves them).  finite ``[3, B]``: whether everything has been
    so far, see ``edtorch.learner.Check``; first_floored ``[B]``: the step of an unroll from which
    on a covariance first had to be floored, -1 as long as none had.
    """

    def __init__(
        self,
        learner: Learner,
        world: World,
        seeds: Sequence[int],
        budget: Budget,
        trail_stride: int = 10,
    ) -> None:
        self.learner = learner
        self.world = world
        self.seeds = list(seeds)
        self.budget = budget
        self.clock = 0
        self.learners: LearnerState = learner.initial(self.seeds)
        self.episodes: list[Episode] = []
        self.finite = torch.ones(len(Check), len(self.seeds), dtype=torch.bool)
        self.first_floored = torch.full((len(self.seeds),), -1, dtype=torch.int64)
        self._everybody = True
        keys = [stream_key(seed, Purpose.LEARNING) for seed in self.seeds]
        actions = len(world.spec.action)
        self._streams = Streams(keys, world.uniforms, actions, world.dtype)
        self.worlds = self._first_worlds()
        self.trail = Trail(self.worlds.world, trail_stride, world.limit_ticks // trail_stride + 2)
        self.trail.append(self.worlds.world, self.worlds.active)
        self._trail_start = [0] * len(self.seeds)
        self._sums = _Sums.zero(len(self.seeds))
        self._dt = torch.tensor(world.dt, dtype=world.dtype)
        self._last_tick = (
            None if budget.seconds is None else max(1, round(budget.seconds / world.dt))
        )

    def _first_worlds(self) -> Experience:
        size = len(self.seeds)
        state = self.world.initial(self._streams.at(0).uniform)
        zero = torch.zeros(size, dtype=torch.int64)
        return Experience(
            world=state,
            start=state,
            observation=self.world.observe(state),
            begun=zero,
            active=torch.ones(size, dtype=torch.bool),
            episodes=zero,
            falls=zero,
            rides=zero,
        )

    def restore(
        self, learners: LearnerState, worlds: Experience, clock: int, finite: Tensor
    ) -> None:
        """Go on from what another ``Training`` of the same seeds has reached."""
        self.learners, self.worlds, self.clock, self.finite = learners, worlds, clock, finite
        self._everybody = bool(worlds.active.all())

    @property
    def done(self) -> bool:
        """Whether every learner has used up its budget."""
        return not bool(self.worlds.active.any())

    @property
    def seconds(self) -> float:
        """Simulated seconds of the learner that has lived longest."""
        return self.clock * self.world.dt

    def advance(self, ticks: int) -> int:
        """Run up to ``ticks`` ticks, fewer if everybody is done before; returns how many."""
        with torch.no_grad() if self.learner.value.needs_autograd else torch.inference_mode():
            for done in range(ticks):
                if self.done:
                    return done
                self._tick()
        return ticks

    def _tick(self) -> None:
        self.clock += 1
        draw = self._streams.at(self.clock)
        here = self.worlds
        action = self.world.clip(self.learner.act(self.learners, here.observation, draw.normal))
        state = self.world.step(here.world, action, draw.uniform)
        observation = self.world.observe(state)
        transition = Transition(here.observation, action, observation, self._dt, here.active)
        self.learners, metrics = self.learner.step(self.learners, transition)

        self.finite &= metrics.finite | ~here.active
        if metrics.first_floored is not None:
            fresh = here.active & (self.first_floored < 0)
            self.first_floored = torch.where(fresh, metrics.first_floored, self.first_floored)
        self._sums.add(metrics, here.active)
        if not self._everybody:
            state = select(here.active, state, here.world)
            observation = select(here.active, observation, here.observation)
        self.worlds = replace(here, world=state, observation=observation)
        if self.clock % self.trail.stride == 0:
            self.trail.append(state, here.active)
        outcome = self.world.outcome(state, self.clock - here.begun)
        ended = (outcome != int(Outcome.RUNNING)) & here.active
        if bool(ended.any()):
            self._end_episodes(ended, outcome, draw)
        if self.clock == self._last_tick:
            self.worlds = replace(self.worlds, active=torch.zeros_like(here.active))

    def _end_episodes(self, ended: Tensor, outcome: Tensor, draw: Draw) -> None:
        """Record the episodes that have just ended, and begin new ones within the budget."""
        here = self.worlds
        seconds = (self.clock - here.begun).to(torch.float64) * self.world.dt
        measures = self.world.sim.measures(here.start, here.world, seconds)
        for row in ended.nonzero().flatten().tolist():
            position = self.trail.position(row)
            self.episodes.append(
                Episode(
                    row=row,
                    number=int(here.episodes[row]),
                    start=int(here.begun[row]) * self.world.dt,
                    seconds=float(seconds[row]),
                    outcome=Outcome(int(outcome[row])),
                    measures={name: float(figure[row]) for name, figure in measures.items()},
                    trail=(self._trail_start[row], position),
                )
            )
            self._trail_start[row] = position
        fell = ended & (outcome == int(Outcome.FAILED))
        episodes, falls = here.episodes + ended, here.falls + fell
        rides = here.rides + (ended & ~fell)
        active = here.active
        if self.budget.episodes is not None:
            active = active & (episodes < self.budget.episodes)
        if self.budget.rides is not None:
            active = active & (rides < self.budget.rides)
        self._everybody = bool(active.all())
        fresh = ended & active
        state = self.world.restart(here.world, fresh, draw.uniform)
        self.worlds = Experience(
            world=state,
            start=select(fresh, state, here.start),
            observation=select(fresh, self.world.observe(state), here.observation),
            begun=torch.where(fresh, self.clock, here.begun),
            active=active,
            episodes=episodes,
            falls=falls,
            rides=rides,
        )

    def snapshot(self) -> Snapshot:
        """The population now; the means begin anew."""
        sums, self._sums = self._sums, _Sums.zero(len(self.seeds))
        here = self.worlds
        squares = [p.flatten(1).square().sum(-1) for p in self.learners.policy.values()]
        return Snapshot(
            seconds=self.seconds,
            seeds=self.seeds,
            active=here.active.tolist(),
            episodes=here.episodes.tolist(),
            falls=here.falls.tolist(),
            rides=here.rides.tolist(),
            episode_seconds=[t * self.world.dt for t in (self.clock - here.begun).tolist()],
            value=(sums.value / sums.ticks).tolist(),
            gradient=(sums.gradient / sums.ticks).tolist(),
            error=(sums.error / sums.ticks).tolist(),
            policy_norm=torch.stack(squares).sum(0).sqrt().tolist(),
        )
