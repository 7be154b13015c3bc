"""A population of learners at work in its worlds, and the record of what it does.

Nothing here writes or prints: the caller of the loop asks it for snapshots and records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import replace as with_fields
from typing import Any, Protocol

import torch
from torch import Tensor

from edtorch.learner.learner import AnyLearner
from edtorch.learner.schedule import ALWAYS, Schedule
from edtorch.run.episodes import Budget, Episode, Snapshot
from edtorch.run.random import Streams, learning_streams, starting_numbers
from edtorch.run.recorder import Recorder
from edtorch.run.rollout import Happened, finished, rollout
from edtorch.run.scaled_sim import World
from edtorch.run.success import settled
from edtorch.run.tick import Experience, Population, Tick
from edtorch.run.trail import Trail
from edtorch.run.trees import tensors_of, with_tensors
from edtorch.types import LearnerState, replace

WATCHED = 16
"""Learners of which the states are kept for pictures: the first ones."""


@dataclass(frozen=True)
class TrailPoints:
    """States of the first learners, for the trail, T of them in the order of their ticks.

    clocks: the ticks; world ``[T, W, k]``, before new episodes began; active ``[T, W]``: whether
    each was within the budget.
    """

    clocks: Sequence[int]
    world: Tensor
    active: Tensor


@dataclass(frozen=True)
class EndedEpisodes:
    """Episodes that have ended, E of them in the order of their ticks, then of the learners.

    clocks: the ticks; rows: of the learners; begun: tick at which each began; numbers: which one of
    its learner's it was, from 0; start, final ``[E, k]``: states of the sim; outcome, earned
    ``[E]``.
    """

    clocks: Sequence[int]
    rows: Sequence[int]
    begun: Sequence[int]
    numbers: Sequence[int]
    start: Tensor
    final: Tensor
    outcome: Tensor
    earned: Tensor


Note = Callable[[TrailPoints | None, EndedEpisodes | None], None]
"""Takes what happened in some ticks, later ones at later calls; None for nothing."""


class Stage(Protocol):
    """A way to run ticks; it holds the population meanwhile."""

    @property
    def population(self) -> Population[LearnerState]:
        """The population now, ``[B, ...]``."""
        ...

    @property
    def done(self) -> bool:
        """Whether everybody has used up the budget."""
        ...

    def replace(self, population: Population[LearnerState]) -> None:
        """Go on with another one of the same size."""
        ...

    def run(self, clock: int, ticks: int, stride: int, note: Note) -> int:
        """Run ticks ``clock + 1`` to ``clock + ticks``, fewer if everybody is done before.

        Notes the ticks at which an episode ended and every ``stride``-th, in order.  Returns how
        many ticks were run.
        """
        ...

    @property
    def piece(self) -> int:
        """Ticks of about a second at most, after which somebody may look whether to stop."""
        ...


class Eager:
    """Tick by tick, each operation by itself: for any learner and any world.

    recorder: is shown every tick, None: nobody is.
    """

    piece = 64

    def __init__(
        self,
        tick: Tick[LearnerState],
        population: Population[LearnerState],
        streams: Streams,
        recorder: Recorder | None = None,
    ) -> None:
        self._tick = tick
        self._streams = streams
        self._recorder = recorder
        self.population = population

    @property
    def done(self) -> bool:
        """See ``Stage``."""
        return not bool(self.population.worlds.active.any())

    def replace(self, population: Population[LearnerState]) -> None:
        """See ``Stage``."""
        self.population = population

    def run(self, clock: int, ticks: int, stride: int, note: Note) -> int:
        """See ``Stage``."""
        now = clock
        for happened in rollout(
            self._tick, self.population, self._streams.at, clock=clock, ticks=ticks
        ):
            now, self.population = happened.clock, happened.population
            if self._recorder is not None:
                self._recorder.add(happened)
            passed = _passed(happened) if now % stride == 0 else None
            ended = _ended(happened) if happened.ended else None
            if passed is not None or ended is not None:
                note(passed, ended)
        return now - clock


def _passed(happened: Happened[LearnerState]) -> TrailPoints:
    world, active = happened.after.world[:WATCHED], happened.before.active[:WATCHED]
    return TrailPoints([happened.clock], world.unsqueeze(0), active.unsqueeze(0))


def _ended(happened: Happened[LearnerState]) -> EndedEpisodes:
    before, after = happened.before, happened.after
    rows = happened.outcome.nonzero().flatten()
    return EndedEpisodes(
        clocks=[happened.clock] * len(rows),
        rows=rows.tolist(),
        begun=before.begun[rows].tolist(),
        numbers=before.episodes[rows].tolist(),
        start=before.start[rows],
        final=after.world[rows],
        outcome=happened.outcome[rows],
        earned=after.earned[rows],
    )


class Training:
    """A population of learners, each in its own world, learning in lockstep.

    seeds: one per learner; learner k draws from the stream of its seed alone, so that it does the
    same in any population.  ``advance`` runs ticks; ``state`` and ``episodes`` are all that the
    future depends on.  recorder: keeps every transition, as long as ``stage`` is the one of the
    beginning.
    """

    def __init__(
        self,
        learner: AnyLearner,
        world: World,
        seeds: Sequence[int],
        budget: Budget,
        trail_stride: int = 10,
        schedule: Schedule = ALWAYS,
        recorder: Recorder | None = None,
    ) -> None:
        self.learner = learner
        self.world = world
        self.seeds = list(seeds)
        self.budget = budget
        self.clock = 0
        self._episodes: list[Episode] = []
        self.lost_episodes = [0] * len(self.seeds)
        self.tick = Tick(learner, world, budget.episodes, budget.successes, schedule)
        streams = learning_streams(world, self.seeds)
        start = world.initial(starting_numbers(world, self.seeds))
        first = self.tick.first(learner.initial(self.seeds), start)
        self.stage: Stage = Eager(self.tick, first, streams, recorder)
        watched = first.worlds.world[:WATCHED]
        self.trail = Trail(watched, trail_stride, world.limit_ticks // trail_stride + 2)
        self.trail.extend(watched.unsqueeze(0), first.worlds.active[:WATCHED].unsqueeze(0))
        self._last_tick = (
            None if budget.seconds is None else max(1, round(budget.seconds / world.dt))
        )

    @property
    def episodes(self) -> list[Episode]:
        """The finished ones of everybody, in the order in which they ended, but for those lost to a
        fault of the simulator (``lost_episodes`` counts them by learner)."""
        if self.world.rule.survival is not None:
            return self._episodes
        return settled(self._episodes, self._episodes)

    @property
    def learners(self) -> LearnerState:
        """What the learners know."""
        return self.stage.population.learners

    @property
    def worlds(self) -> Experience:
        """Where they stand."""
        return self.stage.population.worlds

    @property
    def finite(self) -> Tensor:
        """``[3, B]``: whether everything has been so far, see ``edtorch.learner.learner.Check``."""
        return self.stage.population.tally.finite.T

    @property
    def first_floored(self) -> Tensor:
        """``[B]``: the step of an unroll from which on a covariance first had to be floored, -1 as
        long as none had."""
        return self.stage.population.tally.first_floored

    def counts(self, row: int) -> tuple[int, int]:
        """Episodes and failures of a learner so far."""
        return int(self.worlds.episodes[row]), int(self.worlds.failures[row])

    def state(self) -> dict[str, Any]:
        """Everything that the future depends on, but for the finished episodes."""
        return {
            "seeds": self.seeds,
            "clock": self.clock,
            "population": tensors_of(self.stage.population),
            "trail": self.trail.state(),
            "lost_episodes": list(self.lost_episodes),
            "memory": self.world.memory(),
        }

    def restore(self, state: Mapping[str, Any], episodes: Sequence[Episode]) -> None:
        """Go on from what another ``Training`` of the same settings has reached.

        episodes: those finished until then.  Raises ValueError where the state is that of another
        population.
        """
        if state["seeds"] != self.seeds:
            raise ValueError(f"seeds: the state has {state['seeds']}, expected {self.seeds}")
        population = with_tensors(self.stage.population, state["population"])
        world = self.world.recall(population.worlds.world, state["memory"])
        self.stage.replace(replace(population, worlds=replace(population.worlds, world=world)))
        self.clock = state["clock"]
        self.trail.restore(state["trail"])
        self.lost_episodes = list(state["lost_episodes"])
        self._episodes = list(episodes)

    @property
    def done(self) -> bool:
        """Whether every learner has used up its budget."""
        return self.clock == self._last_tick or self.stage.done

    @property
    def seconds(self) -> float:
        """Simulated seconds of the learner that has lived longest."""
        return self.clock * self.world.dt

    def advance(self, ticks: int) -> int:
        """Run up to ``ticks`` ticks, fewer if everybody is done before; returns how many."""
        with torch.no_grad() if self.learner.needs_autograd else torch.inference_mode():
            return self._advance(ticks)

    def _advance(self, ticks: int) -> int:
        ahead = ticks if self._last_tick is None else min(ticks, self._last_tick - self.clock)
        began = self.clock
        if ahead > 0 and not self.done:
            self.clock += self.stage.run(began, ahead, self.trail.stride, self._note)
        return self.clock - began

    def _note(self, passed: TrailPoints | None, ended: EndedEpisodes | None) -> None:
        """Add to trail and episodes what happened."""
        if passed is not None:
            self.trail.extend(passed.world, passed.active)
        if ended is not None:
            self._record(ended)

    def _record(self, ended: EndedEpisodes) -> None:
        ticks = [clock - first for clock, first in zip(ended.clocks, ended.begun, strict=True)]
        found = finished(
            self.world,
            ended.start,
            ended.final,
            torch.tensor(ticks, device=self.world.device),
            ended.outcome,
            ended.earned,
        )
        for episode, row, number, first in zip(
            found, ended.rows, ended.numbers, ended.begun, strict=True
        ):
            if episode is None:
                self.lost_episodes[row] += 1
                continue
            start = first * self.world.dt
            self._episodes.append(with_fields(episode, row=row, number=number, start=start))

    def path(self, episode: Episode) -> Tensor:
        """States of an episode of one of the first learners, ``[T, k]``, as far as the trail still
        has them."""
        begun, ticks = (round(t / self.world.dt) for t in (episode.start, episode.seconds))
        # The trail has a state before the first tick, and those of every stride-th one.
        first = 0 if begun == 0 else 1 + begun // self.trail.stride
        return self.trail.states(episode.row, first, 1 + (begun + ticks) // self.trail.stride)

    def snapshot(self) -> Snapshot:
        """The population now; the means begin anew."""
        population = self.stage.population
        here, sums = population.worlds, population.tally
        self.stage.replace(replace(population, tally=sums.begun_anew()))
        squares = [p.flatten(1).square().sum(-1) for p in population.learners.policy.values()]
        return Snapshot(
            seconds=self.seconds,
            seeds=self.seeds,
            active=(here.active & (self.clock != self._last_tick)).tolist(),
            episodes=here.episodes.tolist(),
            failures=here.failures.tolist(),
            successes=here.successes.tolist(),
            episode_seconds=[t * self.world.dt for t in (self.clock - here.begun).tolist()],
            value=(sums.value / sums.updates).tolist(),
            gradient=(sums.gradient / sums.updates).tolist(),
            error=(sums.error / sums.ticks).tolist(),
            policy_norm=torch.stack(squares).sum(0).sqrt().tolist(),
        )
