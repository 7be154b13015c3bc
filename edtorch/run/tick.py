"""One tick of a population in its worlds, as pure functions of tensors.

``Tick.live`` lets everybody act and learn (Fig. 1); ``Tick.turn`` begins new episodes where some
have ended.  Neither converts a tensor to a number.  ``edtorch.run.rollout`` runs them one by one;
``edtorch.native`` has the same tick as a compiled loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import torch
from torch import Tensor

from edtorch.learner.learner import Check
from edtorch.learner.schedule import ALWAYS, Schedule
from edtorch.run.random import Draw
from edtorch.run.scaled_sim import World
from edtorch.types import Metrics, Transition, replace, select, tree_dataclass
from sims.base import Outcome

Memory = TypeVar("Memory")
"""What a source of actions remembers, a tree of tensors ``[B, ...]``."""


class Source(Protocol[Memory]):
    """Where actions come from: learners (``edtorch.learner.learner.AnyLearner``), frozen policies,
    controllers.  Its methods are pure: what it remembers goes in and comes out."""

    def begin(self, memory: Memory, fresh: Tensor, observation: Tensor, /) -> Memory:
        """New episodes of those that are ``fresh`` ``[B]``; observation ``[B, n]``: the first one,
        of no meaning for the others."""
        ...

    def act(self, memory: Memory, observation: Tensor, normal: Tensor, /) -> Tensor:
        """The actions ``[B, m]``, scaled, not yet clipped; normal ``[B, m]``: standard normal."""
        ...

    def step(
        self, memory: Memory, transition: Transition, /, *, improve: bool
    ) -> tuple[Memory, Metrics | None]:
        """After what happened in a tick; ``improve``: whether this is a tick to improve at."""
        ...


@tree_dataclass
class Experience:
    """Where each member of a population stands in its world; everything ``[B, ...]``.

    world, start: the sim's state now and at the start of the episode; observation: scaled;
    begun: tick at which the episode began; earned: its return so far, float64; active: still within
    the budget; counters of finished episodes, an episode being a success unless it is known to be
    none (``edtorch.run.success``).
    """

    world: Tensor
    start: Tensor
    observation: Tensor
    begun: Tensor
    earned: Tensor
    active: Tensor
    episodes: Tensor
    failures: Tensor
    successes: Tensor


@tree_dataclass
class Tally:
    """What ``Metrics`` add up to.

    value, gradient: sums over ``updates`` of the policy, error: over ``ticks``, all float64
    ``[B]``; finite ``[B, 3]``:
    whether everything has been, by place (``edtorch.learner.learner.Check``); first_floored
    ``[B]`` int64: the step of an unroll from which on a covariance first had to be floored, -1 if
    none had.
    """

    value: Tensor
    gradient: Tensor
    updates: Tensor
    error: Tensor
    ticks: Tensor
    finite: Tensor
    first_floored: Tensor

    @staticmethod
    def zero(size: int, device: torch.device) -> Tally:
        """Nothing yet."""
        zero = torch.zeros(size, dtype=torch.float64, device=device)
        finite = torch.ones(size, len(Check), dtype=torch.bool, device=device)
        return Tally(zero, zero, zero, zero, zero, finite, torch.full((size,), -1, device=device))

    def add(self, metrics: Metrics | None, active: Tensor) -> Tally:
        """With one more tick of the active learners ``[B]``."""
        if metrics is None:
            return self
        floored = self.first_floored
        if metrics.first_floored is not None:
            fresh = active & (floored < 0)
            floored = torch.where(fresh, metrics.first_floored, floored)
        value, gradient, updates = self.value, self.gradient, self.updates
        if metrics.value is not None and metrics.gradient is not None:
            value = value.addcmul(metrics.value, active)
            gradient = gradient.addcmul(metrics.gradient, active)
            updates = updates + active
        return Tally(
            value=value,
            gradient=gradient,
            updates=updates,
            error=self.error.addcmul(metrics.error, active),
            ticks=self.ticks + active,
            finite=self.finite & (metrics.finite | ~active).movedim(0, -1),
            first_floored=floored,
        )

    def begun_anew(self) -> Tally:
        """The sums at zero, what happened once kept."""
        size, device = len(self.ticks), self.ticks.device
        zero = Tally.zero(size, device)
        return replace(zero, finite=self.finite, first_floored=self.first_floored)


@tree_dataclass
class Population(Generic[Memory]):
    """B learners (or whatever else acts), their worlds, and what was measured of them."""

    learners: Memory
    worlds: Experience
    tally: Tally


def observation(worlds: Experience) -> Tensor:
    """What a source of actions sees of its worlds, as a rule."""
    return worlds.observation


@dataclass(frozen=True)
class Tick(Generic[Memory]):
    """What all ticks of a run have in common.

    learner: acts, and may learn; most_episodes, most_successes: after which it is done, None for no
    limit; schedule: at which ticks policies are improved; view: what the learner acts upon.
    """

    learner: Source[Memory]
    world: World
    most_episodes: int | None = None
    most_successes: int | None = None
    schedule: Schedule = ALWAYS
    view: Callable[[Experience], Tensor] = observation

    def first(self, learners: Memory, state: Tensor) -> Population[Memory]:
        """Everybody at the start ``state`` ``[B, k]`` of a first episode, at tick 0."""
        size, device = state.shape[0], state.device
        zero = torch.zeros(size, dtype=torch.int64, device=device)
        everybody = torch.ones(size, dtype=torch.bool, device=device)
        worlds = Experience(
            world=state,
            start=state,
            observation=self.world.observe(state),
            begun=zero,
            earned=torch.zeros(size, dtype=torch.float64, device=device),
            active=everybody,
            episodes=zero,
            failures=zero,
            successes=zero,
        )
        learners = self.learner.begin(learners, everybody, worlds.observation)
        return Population(learners, worlds, Tally.zero(size, device))

    def live(
        self, here: Population[Memory], draw: Draw, clock: int | Tensor, *, improve: bool
    ) -> tuple[Population[Memory], Transition, Tensor]:
        """Act, let the worlds step, learn from it.

        clock: number of this tick, from 1; improve: what ``schedule`` says of it.  Returns the
        population, what happened, and how the episodes stand, an ``Outcome`` as int64 ``[B]``,
        RUNNING for those that are done.
        """
        worlds, active = here.worlds, here.worlds.active
        action = self.world.clip(self.learner.act(here.learners, self.view(worlds), draw.normal))
        state = self.world.step(worlds.world, action, draw.uniform)
        observation = self.world.observe(state, worlds.observation)
        seconds = self.world.seconds
        applied = self.world.applied(state, action)
        valid = self.world.stepped(state, active)
        transition = Transition(worlds.observation, applied, observation, seconds, valid)
        learners, metrics = self.learner.step(here.learners, transition, improve=improve)
        state = select(active, state, worlds.world)
        observation = select(active, observation, worlds.observation)
        earned = self.world.earned(worlds.earned, state, transition)
        earned = torch.where(active, earned, worlds.earned)
        outcome = self.world.outcome(state, clock - worlds.begun, earned)
        population = Population(
            learners,
            replace(worlds, world=state, observation=observation, earned=earned),
            here.tally.add(metrics, active),
        )
        return population, transition, torch.where(active, outcome, int(Outcome.RUNNING))

    def turn(
        self, here: Population[Memory], outcome: Tensor, draw: Draw, clock: int | Tensor
    ) -> Population[Memory]:
        """Count the episodes that have ended by ``outcome`` ``[B]``, and begin new ones within the
        budget."""
        worlds = here.worlds
        ended = outcome != int(Outcome.RUNNING)
        counts = ended & ~self.world.lost(worlds.world)
        failed = outcome == int(Outcome.FAILED)
        succeeded = ~failed & (self.world.success(worlds.world, outcome) != 0)
        episodes = worlds.episodes + ended
        failures = worlds.failures + (counts & failed)
        successes = worlds.successes + (counts & succeeded)
        active = worlds.active
        if self.most_episodes is not None:
            active = active & (episodes < self.most_episodes)
        if self.most_successes is not None:
            active = active & (successes < self.most_successes)
        fresh = ended & active
        state = self.world.restart(worlds.world, fresh, draw.uniform)
        experience = Experience(
            world=state,
            start=select(fresh, state, worlds.start),
            observation=select(fresh, self.world.observe(state), worlds.observation),
            begun=torch.where(fresh, clock, worlds.begun),
            earned=torch.where(fresh, 0.0, worlds.earned),
            active=active,
            episodes=episodes,
            failures=failures,
            successes=successes,
        )
        learners = self.learner.begin(here.learners, fresh, experience.observation)
        return replace(here, learners=learners, worlds=experience)
