"""Random policy search (section 5 and footnote 1): how many random policies are good ones?

Weights are drawn uniformly, and each policy is run a number of times.  A policy that fails in an
early run needs no further runs, so that most cost one short episode.  Which episodes a policy has,
and how they go, depends on the seed and on the policy's number alone.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import torch
from torch import Tensor

from edtorch.native.choice import Mode
from edtorch.policy.policies import LinearPolicy
from edtorch.rivals.episodes import Ended
from edtorch.rivals.processes import in_processes
from edtorch.rivals.runs import Runs
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.milestones import Checkpoint
from edtorch.run.scaled_sim import World
from sims.base import Outcome

SECONDS_BETWEEN_REPORTS = 0.5


@dataclass(frozen=True)
class RandomSearch:
    """policies: how many; runs: episodes of each; low, high: bounds of the weights, which meet
    scaled states and give scaled actions; processes: of this many cores, None: all that this
    process may use; slots: episodes side by side in each, and look: ticks after which those that
    are over are looked for, where there is no kernel.  These three change the speed, not the
    result."""

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
    needed; cpu_s, compile_s: CPU seconds of the search, and those of them that compiling or loading
    a kernel took, summed over processes.
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


ShardState = Mapping[str, Any]
"""Of a ``Shard`` after a whole round (``_Found``), as ``edtorch.run.state_file`` takes it."""
ShardStates = Sequence[ShardState | None]
"""Of all shards, None for one that has not ended a round."""


@dataclass(frozen=True)
class Report:
    """What a shard has done; state: None unless a round has ended since the last report."""

    progress: Progress
    state: ShardState | None


@dataclass(frozen=True)
class Shard:
    """The part of a search that one process does: policies number first, first + every, ...

    state: to go on from, None to begin.
    """

    settings: RandomSearch
    world: World
    policy: LinearPolicy
    seed: int
    native: Mode
    first: int
    every: int
    state: ShardState | None = None

    def __call__(self, report: Callable[[Report], None]) -> SearchResult:
        """Run it; ``report`` is called about twice a second, and after each round."""
        began = time.process_time()
        slots, look = self.settings.slots, self.settings.look
        runs = Runs(self.world, self.policy, native=self.native, slots=slots, look=look)
        compile_s = time.process_time() - began
        ids = torch.arange(self.first, self.settings.policies, self.every)
        found = _Found(ids, self.settings.runs)
        before = {"steps_done": 0, "cpu_s": 0.0, "compile_s": 0.0}
        if self.state is not None:
            found.restore(self.state["found"])
            before = self.state["spent"]

        def spent() -> dict[str, Any]:
            cpu_s = time.process_time() - began
            own = {"steps_done": runs.steps, "cpu_s": cpu_s, "compile_s": compile_s}
            return {name: before[name] + value for name, value in own.items()}

        def tell(state: ShardState | None = None) -> None:
            report(Report(found.progress(before["steps_done"] + runs.steps), state))

        tell()
        told = time.monotonic()
        while len(number := found.round()):
            place, run = number.unbind(-1)
            weight = policy_weights(self.settings, self.policy, self.seed, ids[place])
            for ended in runs.pieces(weight, episode_key(self.seed, ids[place], run)):
                found.enter(number[ended.number], ended)
                if time.monotonic() - told > SECONDS_BETWEEN_REPORTS:
                    told = time.monotonic()
                    tell()
            found.end_round()
            tell({"found": found.state(), "spent": spent()})
        result = SearchResult(ids, found.outcome, found.ticks, {}, **spent())
        measures = self._measures(result, *found.finals(result.goal))
        return dataclasses.replace(result, measures=measures, **spent())

    def _measures(
        self, result: SearchResult, place: Tensor, run: Tensor, final: Tensor
    ) -> dict[str, Tensor]:
        """Means over the runs ``[F]`` of the policies that always reach the goal, which end in
        ``final`` ``[F, k]``."""
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


class _Found:
    """What is known of P policies, by place: outcome and ticks ``[P, R]`` of their runs.

    Runs come in rounds: the first runs, then as many runs more as there have been, of policies that
    have not failed: most fail in their first.
    """

    def __init__(self, policies: Tensor, runs: int) -> None:
        self.outcome = torch.zeros(len(policies), runs, dtype=torch.int8)
        self.ticks = torch.zeros(len(policies), runs, dtype=torch.int32)
        self._arrived: list[tuple[Tensor, Tensor]] = []
        self._count = 0

    def state(self) -> dict[str, Any]:
        """All of it, between two rounds; a copy, since the next round begins before it is saved."""
        number, final = self._all_arrived()
        return {
            "outcome": self.outcome.clone(),
            "ticks": self.ticks.clone(),
            "arrived": number,
            "final": final,
            "count": self._count,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from such a state."""
        self.outcome, self.ticks = state["outcome"].clone(), state["ticks"].clone()
        self._arrived, self._count = [(state["arrived"], state["final"])], state["count"]

    def _several(self) -> Tensor:
        """The runs of the next round."""
        return torch.arange(self._count, min(self.outcome.shape[1], max(1, 2 * self._count)))

    def round(self) -> Tensor:
        """(place, run) ``[E, 2]`` of the episodes that are next; none when all is known."""
        going = (~(self.outcome == int(Outcome.FAILED)).any(-1)).nonzero().flatten()
        return torch.cartesian_prod(going, self._several()).reshape(-1, 2)

    def end_round(self) -> None:
        """All episodes of the round have been entered.

        A run after one that failed in the same round is forgotten, so that what is known is that of
        one run after the other.
        """
        self._count += len(self._several())
        failed = self.outcome == int(Outcome.FAILED)
        needless = failed.cumsum(-1) - failed.long() > 0
        self.outcome[needless] = int(Outcome.RUNNING)
        self.ticks[needless] = 0

    def enter(self, number: Tensor, ended: Ended) -> None:
        """Episodes that are over, with their (place, run) ``[F, 2]``."""
        place, run = number.unbind(-1)
        self.outcome[place, run] = ended.outcome.to(torch.int8)
        self.ticks[place, run] = ended.ticks.to(torch.int32)
        arrived = ended.outcome == int(Outcome.SUCCEEDED)
        self._arrived.append((number[arrived], ended.state[arrived]))

    def progress(self, steps: int) -> Progress:
        """Of the policies that are decided."""
        failed = (self.outcome == int(Outcome.FAILED)).any(-1)
        whole = (self.outcome != int(Outcome.RUNNING)).all(-1) & ~failed
        goal = int((self.outcome == int(Outcome.SUCCEEDED)).all(-1).sum())
        stable = int(whole.sum()) - goal
        return Progress(int(failed.sum()) + goal + stable, goal, stable, steps)

    def finals(self, wanted: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Place, run ``[F]`` and final state ``[F, k]`` of the runs to the goal of the policies
        ``wanted`` ``[P]``, in order."""
        number, state = self._all_arrived()
        order = (number[:, 0] * self.outcome.shape[1] + number[:, 1]).argsort()
        order = order[wanted[number[order, 0]]]
        return number[order, 0], number[order, 1], state[order]

    def _all_arrived(self) -> tuple[Tensor, Tensor]:
        """(place, run) ``[F, 2]`` of all runs to the goal, and their final states ``[F, k]``."""
        number, final = (torch.cat(parts) for parts in zip(*self._arrived, strict=True))
        self._arrived = [(number, final)]
        return number, final


def search(
    settings: RandomSearch,
    world: World,
    policy: LinearPolicy,
    *,
    seed: int,
    processes: int,
    native: Mode,
    report: Callable[[Progress, ShardStates], None],
    states: ShardStates | None = None,
) -> SearchResult:
    """Run every policy; the same result for any number of processes.

    ``report`` is called a few times a second, with the states that a search by as many processes
    can go on from (``states``); what it raises ends the search.
    """
    count = min(processes, settings.policies)
    reached: list[ShardState | None] = [None] * count if states is None else list(states)
    shards = [
        Shard(settings, world, policy, seed, native, first, count, state)
        for first, state in enumerate(reached)
    ]
    latest = [Progress()] * count

    def take(which: int, told: Report) -> None:
        latest[which] = told.progress
        if told.state is not None:
            reached[which] = told.state
        report(sum(latest, Progress()), list(reached))

    if count == 1:
        return shards[0](partial(take, 0))
    return combined(in_processes(shards, take))


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
