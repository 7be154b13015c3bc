"""Random policy search (section 5 and footnote 1): how many random policies are good ones?

Weights are drawn uniformly, and each policy is run a number of times.  A policy that fails in an
early run needs no further runs, so that most cost one short episode.  Which episodes a policy has,
and how they go, depends on the seed and on the policy's number alone.
"""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from edtorch.compiled.compilation import CompileMode
from edtorch.policy.policies import LinearPolicy
from edtorch.rivals.episodes import Finished, Tile
from edtorch.rivals.processes import in_processes
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.milestones import Checkpoint
from edtorch.run.scaled_sim import World
from sims.base import Outcome

SECONDS_BETWEEN_REPORTS = 0.5


@dataclass(frozen=True)
class RandomSearch:
    """policies: how many; runs: episodes of each; low, high: bounds of the weights, which meet
    scaled states and give scaled actions; slots: episodes at a time in a process; look: ticks
    between two looks at them; processes: of this many cores, None: all that this process may use.
    The last three change the speed, not the result."""

    policies: int = 100_000
    runs: int = 30
    low: float = -2.0
    high: float = 2.0
    slots: int = 1024
    look: int = 128
    processes: int | None = None

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        for name, least in (("policies", 1), ("runs", 1), ("slots", 2), ("look", 1)):
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"{name}={value}: expected an integer >= {least}")
        for name in ("policies", "runs"):
            if getattr(self, name) >= 2**31:
                raise ValueError(f"{name}={getattr(self, name)}: expected less than 2^31")
        if not self.low < self.high:
            raise ValueError(f"low={self.low}: expected less than high, {self.high}")


@dataclass(frozen=True)
class Progress:
    """Of some policies: how many are decided, how many of those are good (goal in all runs) and
    stable (no failure, but not always the goal); simulator steps so far."""

    decided: int = 0
    goal: int = 0
    stable: int = 0
    steps: int = 0

    def __add__(self, other: Progress) -> Progress:
        return Progress(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


@dataclass(frozen=True)
class SearchResult:
    """What P policies did.

    policy ``[P]``: their numbers; outcome ``[P, R]`` int8 and ticks ``[P, R]`` int32 of the runs,
    RUNNING and 0 for runs after the first that failed, which were not needed; measures: the sim's
    figures, means over the runs, each ``[P]``, NaN but for the policies with ``goal``.

    steps_done: simulator steps that were made, those of runs included that turned out not to be
    needed; cpu_s, compile_s: CPU seconds of the search, and those of them before its first tick was
    compiled, summed over processes.
    """

    policy: Tensor
    outcome: Tensor
    ticks: Tensor
    measures: dict[str, Tensor]
    steps_done: int
    cpu_s: float
    compile_s: float

    @property
    def goal(self) -> Tensor:
        """Whether every run ended at the goal, ``[P]``."""
        return (self.outcome == int(Outcome.SUCCEEDED)).all(-1)

    @property
    def stable(self) -> Tensor:
        """Whether no run failed, but not all ended at the goal, ``[P]``."""
        return ~(self.outcome == int(Outcome.FAILED)).any(-1) & ~self.goal

    @property
    def steps(self) -> int:
        """Simulator steps that one policy after the other, one run after the other, takes."""
        return int(self.ticks.sum())

    @property
    def episodes(self) -> int:
        """Episodes that this takes."""
        return int((self.outcome != int(Outcome.RUNNING)).sum())

    def paid(self, place: int, dt: float, cpu_s_per_step: float) -> Checkpoint:
        """What this search has paid once the policy at ``place`` is decided, the k-th that it
        tries being the k-th here; its own runs are the fresh episodes of the checkpoint.

        dt: seconds of a step; cpu_s_per_step: CPU seconds of the run, what was not needed
        included, per step that it made.
        """
        outcome = self.outcome[: place + 1]
        ran = outcome != int(Outcome.RUNNING)
        steps = int(self.ticks[: place + 1].sum())
        own = outcome[-1][ran[-1]]
        return Checkpoint(
            seconds=steps * dt,
            episodes=int(ran.sum()),
            failures=int((outcome == int(Outcome.FAILED)).sum()),
            cpu_s=steps * cpu_s_per_step,
            tried=len(own),
            failure_rate=float((own == int(Outcome.FAILED)).double().mean()),
            goal_rate=float((own == int(Outcome.SUCCEEDED)).double().mean()),
            measures={name: float(values[place]) for name, values in self.measures.items()},
        )

    def history(self, dt: float, cpu_s_per_step: float) -> list[Checkpoint]:
        """``paid`` for the first policy that never failed, the first that always reached the goal,
        where there are such, and the last of all, in order."""
        firsts = [found.nonzero().flatten()[:1] for found in (self.goal | self.stable, self.goal)]
        places = {int(place) for place in torch.cat(firsts)} | {len(self.policy) - 1}
        return [self.paid(place, dt, cpu_s_per_step) for place in sorted(places)]


def policy_weights(settings: RandomSearch, policy: LinearPolicy, seed: int, ids: Tensor) -> Tensor:
    """Weights ``[P, m, n]``, uniform in [low, high), of the policies numbered ids ``[P]``."""
    key = hash_key(Use.WEIGHTS, seed, ids)
    shape = policy.weight.shape
    numbers = uniform(key, torch.zeros_like(ids), shape.numel())
    weights = settings.low + (settings.high - settings.low) * numbers
    return weights.unflatten(-1, shape)


def episode_key(seed: int, ids: Tensor, run: Tensor) -> Tensor:
    """Keys ``[F, 2]`` of the uniforms of run ``[F]`` of policy ids ``[F]``; their counter is the
    tick, 0 for the start."""
    return hash_key(Use.EPISODE, seed, ids, run)


class _Schedule:
    """Which run of which policy is next, and what is known of each.

    First runs come before all others; runs after one that failed are not needed, runs before it
    are, so that what is known in the end does not depend on the order in which it became known.
    """

    def __init__(self, policies: int, runs: int) -> None:
        self.runs = runs
        self.outcome = torch.zeros(policies, runs, dtype=torch.int8)
        self.ticks = torch.zeros(policies, runs, dtype=torch.int32)
        self._first = iter(range(policies))
        self._more: deque[tuple[int, int]] = deque()
        self._failed = [runs] * policies  # the first run known to have failed
        self._left = [runs] * policies
        self._succeeded = [0] * policies
        self._slots: dict[int, dict[int, int]] = {}
        self._at: dict[int, tuple[int, int]] = {}
        self.decided = self.goal = self.stable = 0

    def _waiting(self) -> Iterator[tuple[int, int]]:
        for place in self._first:
            yield place, 0
        while self._more:
            place, run = self._more.popleft()
            if run < self._failed[place]:
                yield place, run

    def take(self, slots: list[int]) -> list[tuple[int, int, int]]:
        """(slot, policy, run) of the next episodes for free slots."""
        taken: list[tuple[int, int, int]] = []
        waiting = self._waiting()
        for slot in slots:
            # The slot first: an episode that is taken must have one.
            following = next(waiting, None)
            if following is None:
                break
            place, run = following
            self._slots.setdefault(place, {})[run] = slot
            self._at[slot] = following
            taken.append((slot, place, run))
        return taken

    def finish(self, slot: int, outcome: int, ticks: int) -> list[int]:
        """Note the end of an episode; the slots of episodes that are no longer needed."""
        place, run = self._at.pop(slot)
        del self._slots[place][run]
        self.outcome[place, run] = outcome
        self.ticks[place, run] = ticks
        self._left[place] -= 1
        self._succeeded[place] += outcome == int(Outcome.SUCCEEDED)
        if outcome == int(Outcome.FAILED):
            self.decided += self._failed[place] == self.runs
            self._failed[place] = min(run, self._failed[place])
            needless = [r for r in self._slots[place] if r > self._failed[place]]
            slots = [self._slots[place].pop(r) for r in needless]
            for other in slots:
                del self._at[other]
            return slots
        if run == 0:
            self._more.extend((place, r) for r in range(1, self.runs))
        if self._left[place] == 0 and self._failed[place] == self.runs:
            self.decided += 1
            self.goal += self._succeeded[place] == self.runs
            self.stable += self._succeeded[place] != self.runs
        return []

    def forget_needless(self) -> None:
        """Take out runs after the first that failed: whether they ended depends on the order."""
        failed = (self.outcome == int(Outcome.FAILED)).cumsum(-1)
        needless = failed - (self.outcome == int(Outcome.FAILED)).to(failed.dtype) > 0
        self.outcome[needless] = int(Outcome.RUNNING)
        self.ticks[needless] = 0


class Stopped(Exception):
    """Somebody asked the search to stop."""


@dataclass(frozen=True)
class Shard:
    """The part of a search that one process does: policies number first, first + every, ..."""

    settings: RandomSearch
    world: World
    policy: LinearPolicy
    seed: int
    mode: CompileMode
    first: int
    every: int

    def __call__(self, report: Callable[[Progress], None]) -> SearchResult:
        """Run it; ``report`` is called about twice a second."""
        with torch.inference_mode():
            return self._run(report)

    def _run(self, report: Callable[[Progress], None]) -> SearchResult:
        settings = self.settings
        began = time.process_time()
        ids = torch.arange(self.first, settings.policies, self.every)
        weights = policy_weights(settings, self.policy, self.seed, ids)
        schedule = _Schedule(len(ids), settings.runs)
        tile = Tile(
            self.world, self.policy, slots=settings.slots, look=settings.look, mode=self.mode
        )
        nobody = episode_key(self.seed, ids[:0], ids[:0])
        finals = _Finals(
            self.world.initial(uniform(nobody, ids[:0], self.world.uniforms)),
        )
        compile_s, steps, reported = 0.0, 0, time.monotonic()
        while True:
            taken = schedule.take(tile.free())
            if taken:
                slot, place, run = torch.tensor(taken).unbind(-1)
                tile.place(slot, weights[place], episode_key(self.seed, ids[place], run))
                finals.begin(taken)
            if tile.busy == 0:
                break
            steps += tile.busy * settings.look
            finished = tile.advance()
            if compile_s == 0.0:
                compile_s = time.process_time() - began
            finals.end(finished)
            rows = (finished.slot.tolist(), finished.outcome.tolist(), finished.ticks.tolist())
            needless: list[int] = []
            for slot, outcome, ticks in zip(*rows, strict=True):
                if slot in needless:
                    continue
                needless += schedule.finish(slot, outcome, ticks)
            if needless:
                tile.drop(torch.tensor(needless))
            if time.monotonic() - reported > SECONDS_BETWEEN_REPORTS:
                reported = time.monotonic()
                report(Progress(schedule.decided, schedule.goal, schedule.stable, steps))
        schedule.forget_needless()
        report(Progress(schedule.decided, schedule.goal, schedule.stable, steps))
        result = SearchResult(
            policy=ids,
            outcome=schedule.outcome,
            ticks=schedule.ticks,
            measures={},
            steps_done=steps,
            cpu_s=0.0,
            compile_s=compile_s,
        )
        measures = self._measures(result, finals)
        cpu_s = time.process_time() - began
        return dataclasses.replace(result, measures=measures, cpu_s=cpu_s)

    def _measures(self, result: SearchResult, finals: _Finals) -> dict[str, Tensor]:
        """Means over the runs of the policies that always reach the goal."""
        place, run, final = finals.of(result.goal)
        key = episode_key(self.seed, result.policy[place], run)
        numbers = uniform(key, torch.zeros_like(run), self.world.uniforms)
        seconds = result.ticks[place, run].to(torch.float64) * self.world.dt
        found = self.world.sim.measures(self.world.initial(numbers), final, seconds)
        means: dict[str, Tensor] = {}
        for name, figures in found.items():
            sums = torch.zeros(len(result.policy), dtype=torch.float64)
            sums.index_add_(0, place, figures.to(torch.float64))
            means[name] = torch.where(result.goal, sums / self.settings.runs, torch.nan)
        return means


class _Finals:
    """Final states of the episodes that reached the goal, with policy and run."""

    def __init__(self, none: Tensor) -> None:
        """none: states ``[0, k]``, of no episode."""
        self._at: dict[int, tuple[int, int]] = {}
        self._episodes: list[tuple[int, int]] = []
        self._states = [none]

    def begin(self, taken: list[tuple[int, int, int]]) -> None:
        self._at |= {slot: (place, run) for slot, place, run in taken}

    def end(self, finished: Finished) -> None:
        reached = finished.outcome == int(Outcome.SUCCEEDED)
        if bool(reached.any()):
            self._episodes += [self._at[slot] for slot in finished.slot[reached].tolist()]
            self._states.append(finished.state[reached])

    def of(self, wanted: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Policy, run ``[F]`` and final state ``[F, k]`` of those of the policies ``wanted``, in
        order."""
        episodes = torch.tensor(self._episodes, dtype=torch.int64).reshape(-1, 2)
        place, run = episodes.unbind(-1)
        order = (place * 2**31 + run).argsort()
        order = order[wanted[place[order]]]
        return place[order], run[order], torch.cat(self._states)[order]


def search(
    settings: RandomSearch,
    world: World,
    policy: LinearPolicy,
    *,
    seed: int,
    processes: int,
    mode: CompileMode,
    report: Callable[[Progress], None],
) -> SearchResult:
    """Run every policy; the same result for any number of processes.

    ``report`` is called a few times a second; what it raises ends the search.
    """
    shares = [
        Shard(settings, world, policy, seed, mode, first, processes)
        for first in range(min(processes, settings.policies))
    ]
    if len(shares) == 1:
        return shares[0](report)
    latest = [Progress()] * len(shares)

    def report_sum(which: int, progress: Progress) -> None:
        latest[which] = progress
        report(sum(latest, Progress()))

    return combined(in_processes(shares, report_sum))


def combined(parts: list[SearchResult]) -> SearchResult:
    """One result of several, by the numbers of the policies."""
    order = torch.cat([part.policy for part in parts]).argsort()
    return SearchResult(
        policy=torch.cat([part.policy for part in parts])[order],
        outcome=torch.cat([part.outcome for part in parts])[order],
        ticks=torch.cat([part.ticks for part in parts])[order],
        measures={
            name: torch.cat([part.measures[name] for part in parts])[order]
            for name in parts[0].measures
        },
        steps_done=sum(part.steps_done for part in parts),
        cpu_s=sum(part.cpu_s for part in parts),
        compile_s=sum(part.compile_s for part in parts),
    )
