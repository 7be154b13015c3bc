"""A population of learners at work in its worlds, and the record of what it does.

Nothing here writes or prints: the caller of the loop asks it for snapshots and records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as with_fields
from typing import Protocol

import torch
from torch import Tensor

from edtorch.learner.learner import AnyLearner
from edtorch.learner.schedule import ALWAYS, Schedule
from edtorch.run.episodes import Budget, Episode, Snapshot
from edtorch.run.random import Streams, learning_streams
from edtorch.run.recorder import Recorder
from edtorch.run.rollout import Happened, finished, rollout
from edtorch.run.scaled_sim import World
from edtorch.run.success import settled
from edtorch.run.tick import Experience, Population, Tick
from edtorch.run.trail import Trail
from edtorch.types import LearnerState, replace

WATCHED = 16
"""Learners of which the states are kept for pictures: the first ones."""


@dataclass(frozen=True)
class Ended:
    """Episodes that ended at one tick, E of them.

    rows: of the learners, rising; begun: tick at which each began; numbers: which one of its
    learner's it was, from 0; start, final ``[E, k]``: states of the sim; outcome, earned ``[E]``.
    """

    rows: Sequence[int]
    begun: Sequence[int]
    numbers: Sequence[int]
    start: Tensor
    final: Tensor
    outcome: Tensor
    earned: Tensor


@dataclass(frozen=True)
class Moment:
    """A tick worth a note.

    passed: states ``[W, k]`` of the first learners, and whether each was active ``[W]``, before new
    episodes began; None where this tick is not for the trail; ended: None if no episode did.
    """

    clock: int
    passed: tuple[Tensor, Tensor] | None
    ended: Ended | None


Note = Callable[[Sequence[Moment]], None]
"""Takes moments in the order of their ticks."""


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
            if happened.ended or now % stride == 0:
                note([_moment(happened, trailed=now % stride == 0)])
        return now - clock


def _moment(happened: Happened[LearnerState], *, trailed: bool) -> Moment:
    before, after = happened.before, happened.after
    rows = happened.outcome.nonzero().flatten()
    ended = Ended(
        rows=rows.tolist(),
        begun=before.begun[rows].tolist(),
        numbers=before.episodes[rows].tolist(),
        start=before.start[rows],
        final=after.world[rows],
        outcome=happened.outcome[rows],
        earned=after.earned[rows],
    )
    passed = (after.world[:WATCHED], before.active[:WATCHED]) if trailed else None
    return Moment(happened.clock, passed, ended if ended.rows else None)


class Training:
    """A population of learners, each in its own world, learning in lockstep.

    seeds: one per learner; learner k draws from the stream of its seed alone, so that it does the
    same in any population.  ``advance`` runs ticks; ``learners``, ``worlds`` and ``clock`` are the
    whole state (``edtorch.run.checkpoint`` saves them).  recorder: keeps every transition, as long
    as ``stage`` is the one of the beginning.
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
        first = self.tick.first(learner.initial(self.seeds), world.initial(streams.at(0).uniform))
        self.stage: Stage = Eager(self.tick, first, streams, recorder)
        watched = first.worlds.world[:WATCHED]
        self.trail = Trail(watched, trail_stride, world.limit_ticks // trail_stride + 2)
        self.trail.append(watched, first.worlds.active[:WATCHED])
        self._trail_start = [0] * self.trail.size
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

    def restore(
        self, learners: LearnerState, worlds: Experience, clock: int, finite: Tensor
    ) -> None:
        """Go on from what another ``Training`` of the same seeds has reached."""
        tally = replace(self.stage.population.tally, finite=finite.T)
        self.stage.replace(Population(learners, worlds, tally))
        self.clock = clock

    @property
    def done(self) -> bool:
        """Whether every learner has used up its budget."""
        return self.stage.done

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
        if self.clock == self._last_tick:
            population = self.stage.population
            stopped = torch.zeros_like(population.worlds.active)
            self.stage.replace(
                replace(population, worlds=replace(population.worlds, active=stopped))
            )
        return self.clock - began

    def _note(self, moments: Sequence[Moment]) -> None:
        """Add to trail and episodes what happened, in the order of the ticks."""
        ends: list[tuple[int, Ended]] = []
        trails: list[tuple[int, int]] = []
        for moment in moments:
            if moment.passed is not None:
                self.trail.append(*moment.passed)
            if moment.ended is not None:
                ends.append((moment.clock, moment.ended))
                trails += [self._cut_trail(row) for row in moment.ended.rows]
        if ends:
            self._record(ends, trails)

    def _cut_trail(self, row: int) -> tuple[int, int]:
        """Where in the trail the episode of a learner was that has just ended."""
        if row >= self.trail.size:
            return 0, 0
        began, self._trail_start[row] = self._trail_start[row], self.trail.position(row)
        return began, self._trail_start[row]

    def _record(
        self, ends: Sequence[tuple[int, Ended]], trails: Sequence[tuple[int, int]]
    ) -> None:
        """Episodes that have ended, by clock, and where in the trail they are."""
        every = [each for _, each in ends]
        begun = [first for each in every for first in each.begun]
        clocks = [clock for clock, each in ends for _ in each.rows]
        ticks = [clock - first for clock, first in zip(clocks, begun, strict=True)]
        found = finished(
            self.world,
            torch.cat([each.start for each in every]),
            torch.cat([each.final for each in every]),
            torch.tensor(ticks, device=self.world.device),
            torch.cat([each.outcome for each in every]),
            torch.cat([each.earned for each in every]),
        )
        rows = [row for each in every for row in each.rows]
        numbers = [number for each in every for number in each.numbers]
        for episode, row, number, first, trail in zip(
            found, rows, numbers, begun, trails, strict=True
        ):
            if episode is None:
                self.lost_episodes[row] += 1
                continue
            start = first * self.world.dt
            self._episodes.append(
                with_fields(episode, row=row, number=number, start=start, trail=trail)
            )

    def snapshot(self) -> Snapshot:
        """The population now; the means begin anew."""
        population = self.stage.population
        here, sums = population.worlds, population.tally
        self.stage.replace(replace(population, tally=sums.begun_anew()))
        squares = [p.flatten(1).square().sum(-1) for p in population.learners.policy.values()]
        return Snapshot(
            seconds=self.seconds,
            seeds=self.seeds,
            active=here.active.tolist(),
            episodes=here.episodes.tolist(),
            failures=here.failures.tolist(),
            successes=here.successes.tolist(),
            episode_seconds=[t * self.world.dt for t in (self.clock - here.begun).tolist()],
            value=(sums.value / sums.updates).tolist(),
            gradient=(sums.gradient / sums.updates).tolist(),
            error=(sums.error / sums.ticks).tolist(),
            policy_norm=torch.stack(squares).sum(0).sqrt().tolist(),
        )
