"""Learning from recorded transitions of any policy (section 6: off-policy).

The model is fitted to each learner's transitions by ``Learner.step``, one after the other, as if
they were its own; then the policy climbs on the model as it is, which costs no experience, until
its step is small.  What is recorded far from where the model is to hold may be left out: a model
linear in the state is a local one, and a fall leaves the place where it is good.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from edtorch.learner.learner import Learner
from edtorch.learner.schedule import Schedule
from edtorch.policy.steps import gradient_norm
from edtorch.run.episodes import Budget, Episode, Snapshot
from edtorch.run.recorded import Recorded, first_rows
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tally
from edtorch.run.trees import tensors_of, with_tensors
from edtorch.types import Metrics, Parameters, Transition, replace, select
from sims.base import Outcome

EpisodeSharing = Literal["own", "all", "bootstrap"]
Order = Literal["recorded", "shuffled"]
_BLOCK = 512
"""Transitions of each learner that are brought together at once."""


class _Draw(IntEnum):
    """What a learner's random numbers are for; each is independent of the others."""

    EPISODES = 0
    ORDER = 1
    STARTS = 2


def _generator(seed: int, what: _Draw) -> np.random.Generator:
    """A stream of the learner's own, so that it does the same in any population."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(what),)))


@dataclass(frozen=True)
class Lessons:
    """Which recorded transitions a learner uses, and in which order.

    share: own, the episodes recorded with its seed; all; or bootstrap, a sample of the episodes of
    the same size, drawn with replacement (Efron, 1979).  order: within a pass, as recorded or
    shuffled anew.  passes: over all of them.  within: by index of a state component, the greatest
    absolute value, physical units, of transitions that are used.
    """

    share: EpisodeSharing = "own"
    order: Order = "recorded"
    passes: int = 1
    within: tuple[tuple[int, float], ...] = ()

    def __post_init__(self) -> None:
        for name, known in (("share", EpisodeSharing), ("order", Order)):
            if getattr(self, name) not in get_args(known):
                raise ValueError(
                    f"{name}={getattr(self, name)}: expected one of {', '.join(get_args(known))}"
                )
        if self.passes < 1:
            raise ValueError(f"passes={self.passes}: expected at least one")

    def share_of(self, data: Recorded, seed: int) -> np.ndarray:
        """Rows of ``data`` that the learner with this seed may have, in order.  ValueError if there
        are none."""
        first = np.flatnonzero(first_rows(data.episode))
        after = np.append(first[1:], len(data))
        if self.share == "own":
            own = data.seed[first] == seed
            if not own.any():
                known = sorted(set(data.seed[data.seed >= 0].tolist()))
                listed = _listed(known) if known else "none: it names no seeds"
                raise ValueError(
                    f"share=own: nothing is recorded of seed {seed}; the data have {listed};"
                    " expected those, or share=all or bootstrap"
                )
            first, after = first[own], after[own]
        if self.share == "bootstrap":
            drawn = _generator(seed, _Draw.EPISODES).integers(len(first), size=len(first))
            first, after = first[drawn], after[drawn]
        lengths = after - first
        before = np.cumsum(lengths) - lengths
        return np.arange(lengths.sum()) + np.repeat(first - before, lengths)

    def assigned(self, data: Recorded, seed: int, budget: Budget | None) -> np.ndarray:
        """Rows of ``data`` that make up the experience of the learner with this seed, in order,
        those that it cannot learn from included.  ValueError if it has none."""
        return within_budget(data, self.share_of(data, seed), budget)

    def usable(self, data: Recorded, rows: np.ndarray) -> np.ndarray:
        """Those of ``rows`` that are learned from."""
        good = data.valid[rows]
        for component, bound in self.within:
            good = good & (np.abs(data.state[rows, component]) <= bound)
        return rows[good]

    def sequence(self, rows: np.ndarray, seed: int) -> np.ndarray:
        """``rows`` as often and in the order in which the learner of this seed sees them."""
        if self.order == "recorded":
            return np.tile(rows, self.passes)
        generator = _generator(seed, _Draw.ORDER)
        return np.concatenate([generator.permutation(rows) for _ in range(self.passes)])


def within_budget(data: Recorded, rows: np.ndarray, budget: Budget | None) -> np.ndarray:
    """The first of ``rows``, whole episodes in order, that a budget allows; None: all of them."""
    if budget is None:
        return rows
    most = len(rows)
    if budget.episodes is not None:
        begin = np.flatnonzero(first_rows(data.episode)[rows])
        if len(begin) > budget.episodes:
            most = int(begin[budget.episodes])
    if budget.seconds is not None:
        lived = np.cumsum(_seconds(data, rows))
        allowed = np.searchsorted(lived, budget.seconds * (1 + 1e-9), side="right")
        most = min(most, int(allowed))
    if budget.successes is not None:
        good = np.flatnonzero(data.succeeded[rows])
        if len(good) >= budget.successes:
            most = min(most, int(good[budget.successes - 1]) + 1)
    return rows[:most]


def _listed(seeds: Sequence[int], most: int = 10) -> str:
    more = f" and {len(seeds) - most} more" if len(seeds) > most else ""
    return "seeds " + ", ".join(map(str, seeds[:most])) + more


def _seconds(data: Recorded, rows: np.ndarray) -> np.ndarray:
    """What each row took; nothing where the file does not know."""
    dt = data.dt[rows]
    return np.where(np.isfinite(dt) & (dt > 0), dt, 0.0)


@dataclass(frozen=True)
class _Ends:
    """The episodes in a learner's experience: where each ends in ``data``, and its first and last
    second.  Nothing can be said of those that somebody stopped, which are numbered but left out."""

    row: np.ndarray
    number: np.ndarray
    start: np.ndarray
    end: np.ndarray

    @staticmethod
    def within(data: Recorded, rows: np.ndarray) -> _Ends:
        seconds = np.cumsum(_seconds(data, rows))
        places = np.flatnonzero(data.terminated[rows] | data.truncated[rows])
        ends = seconds[places]
        starts = np.append(0.0, ends)[:-1]
        told = data.terminated[rows[places]]
        number = np.arange(len(places))
        return _Ends(rows[places][told], number[told], starts[told], ends[told])

    def episodes(self, data: Recorded, row: int) -> list[Episode]:
        """As those of the learner in place ``row``."""
        good = data.succeeded[self.row].tolist()
        numbers = (self.number.tolist(), self.start.tolist(), self.end.tolist())
        return [
            Episode(row, k, start, end - start, Outcome.SUCCEEDED if well else Outcome.FAILED, {})
            for k, start, end, well in zip(*numbers, good, strict=True)
        ]


@dataclass(frozen=True)
class Unused:
    """Rows of the data that a learner does not learn from, by reason.

    other_seeds: recorded from other seeds (share=own); not_drawn: of no episode that was drawn
    (share=bootstrap); budget: beyond it; masked: not ``valid``; within: sound, but beyond those
    bounds.
    """

    other_seeds: int
    not_drawn: int
    budget: int
    masked: int
    within: int


class Offline:
    """A population of learners, each at its share of recorded transitions.

    ``advance`` gives them the next ones; once there are no more (``all_seen``), ``climb`` improves
    the policies on the models as they are.  Raises ValueError where a learner has nothing to learn
    from.
    """

    def __init__(
        self,
        learner: Learner,
        world: World,
        data: Recorded,
        seeds: Sequence[int],
        lessons: Lessons,
        budget: Budget | None,
        *,
        schedule: Schedule | None = None,
        tolerance: float = 1e-6,
    ) -> None:
        """schedule: when policies are improved while the transitions pass, None: not then;
        tolerance: a policy whose step is smaller than this share of it has arrived."""
        self.learner = learner
        self.world = world
        self.seeds = list(seeds)
        self.learners = learner.initial(self.seeds)
        self.clock = 0
        self.experience: list[float] = []
        self.used: list[int] = []
        self.unused: list[Unused] = []
        self._data = data
        self._ends: list[_Ends] = []
        self._schedule = schedule
        self._tolerance = tolerance
        self._order: list[np.ndarray] = []
        for seed in self.seeds:
            share = lessons.share_of(data, seed)
            rows = within_budget(data, share, budget)
            usable = lessons.usable(data, rows)
            if len(usable) == 0:
                raise ValueError(
                    f"data: seed {seed} has {len(rows)} transitions and none to learn from;"
                    " expected one that is sound and within bounds (within)"
                )
            self._ends.append(_Ends.within(data, rows))
            self.experience.append(float(_seconds(data, rows).sum()))
            self.used.append(len(usable))
            elsewhere = len(data) - len(np.unique(share))
            sound = int(data.valid[rows].sum())
            self.unused.append(
                Unused(
                    other_seeds=elsewhere if lessons.share == "own" else 0,
                    not_drawn=elsewhere if lessons.share == "bootstrap" else 0,
                    budget=len(share) - len(rows),
                    masked=len(rows) - sound,
                    within=sound - len(usable),
                )
            )
            self._order.append(lessons.sequence(usable, seed))
        good = [int(data.succeeded[own.row].sum()) for own in self._ends]
        self._counts = (
            [len(own.row) for own in self._ends],
            [len(own.row) - well for own, well in zip(self._ends, good, strict=True)],
            good,
        )
        self._lengths = torch.tensor([len(own) for own in self._order])
        scales = [
            [q.scale for q in quantities] for quantities in (world.spec.state, world.spec.action)
        ]
        self._state = self._tensor(data.state / np.array(scales[0]))
        self._action = self._tensor(data.action / np.array(scales[1]))
        self._next = self._tensor(data.next_state / np.array(scales[0]))
        self._dt = data.dt
        self._seen = np.zeros(len(self.seeds))
        self._tally = Tally.zero(len(self.seeds), world.device)
        self._block = -1
        self._starts = [_generator(seed, _Draw.STARTS) for seed in self.seeds]
        self.moving = torch.ones(len(self.seeds), dtype=torch.bool, device=world.device)
        self.steps = torch.zeros(len(self.seeds), dtype=torch.int64, device=world.device)

    def _tensor(self, numbers: np.ndarray) -> Tensor:
        return torch.from_numpy(numbers).to(self.world.device, self.world.dtype)

    @property
    def ticks(self) -> int:
        """How many transitions the learner sees that sees most."""
        return int(self._lengths.max())

    @property
    def all_seen(self) -> bool:
        """Whether everybody has seen all of its transitions as often as it is to."""
        return self.clock >= self.ticks

    @property
    def seconds(self) -> float:
        """Seconds of data that the learner that has seen most has learned from."""
        return float(self._seen.max())

    @property
    def finite(self) -> Tensor:
        """``[3, B]``: whether everything has been so far, see ``edtorch.learner.learner.Check``."""
        return self._tally.finite.T

    @property
    def first_floored(self) -> Tensor:
        """``[B]``: the step of an unroll from which on a covariance first had to be floored, -1 as
        long as none had."""
        return self._tally.first_floored

    @property
    def episodes(self) -> list[Episode]:
        """Those in the experience of each learner that came to an end of their own."""
        return self._episodes

    @cached_property
    def _episodes(self) -> list[Episode]:
        return [e for row, own in enumerate(self._ends) for e in own.episodes(self._data, row)]

    def advance(self, ticks: int) -> int:
        """Learn from up to ``ticks`` more transitions each; returns how many."""
        ahead = min(ticks, self.ticks - self.clock)
        with self._mode():
            for _ in range(ahead):
                self._tick()
        return ahead

    def counts(self, row: int) -> tuple[int, int]:
        """Episodes and failures in the transitions of a learner."""
        episodes, failures, _ = self._counts
        return episodes[row], failures[row]

    def learn(self, steps: int, every: int) -> Iterator[None]:
        """All transitions, then up to ``steps`` improvements, those already made included; yields
        after each ``every`` of either."""
        while not self.all_seen:
            self.advance(every)
            yield
        # A policy that still moves has taken part in each of them.
        while bool(self.moving.any()) and (left := steps - int(self.steps.max())) > 0:
            self.climb(min(every, left))
            yield

    def state(self) -> dict[str, Any]:
        """Everything that the future depends on, beside what it was built from."""
        return {
            "data": self._digest,
            "tensors": tensors_of(self._tensors()),
            "seen": self._seen.copy(),
            "clock": self.clock,
            "starts": [generator.bit_generator.state for generator in self._starts],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what another one, built from the same, has reached.

        Raises ValueError for the state of other learners or other data.
        """
        if state["data"] != self._digest:
            raise ValueError(
                "data: expected the transitions, in the order, that the state was reached with;"
                " the files, the budget or the lessons are others"
            )
        tensors = with_tensors(self._tensors(), state["tensors"])
        self.learners, self._tally = tensors["learners"], tensors["tally"]
        self.moving, self.steps = tensors["moving"], tensors["steps"]
        self._seen, self.clock = state["seen"].copy(), state["clock"]
        for generator, there in zip(self._starts, state["starts"], strict=True):
            generator.bit_generator.state = there

    def _tensors(self) -> dict[str, Any]:
        return {
            "learners": self.learners,
            "tally": self._tally,
            "moving": self.moving,
            "steps": self.steps,
        }

    @cached_property
    def _digest(self) -> str:
        """Of the transitions, and of the order in which each learner sees them."""
        found = hashlib.blake2b(digest_size=16)
        data = self._data
        for array in (data.state, data.action, data.next_state, data.dt, *self._order):
            found.update(np.ascontiguousarray(array).data)
        return found.hexdigest()

    def _mode(self) -> torch.no_grad | torch.inference_mode:
        return torch.no_grad() if self.learner.needs_autograd else torch.inference_mode()

    def _fetch(self, block: int) -> None:
        """Bring the transitions of a block together, ``[_BLOCK, B, ...]``."""
        first = block * _BLOCK
        rows = np.stack(
            [
                own[np.minimum(np.arange(first, first + _BLOCK), len(own) - 1)]
                for own in self._order
            ],
            axis=1,
        )
        index = torch.from_numpy(rows).to(self.world.device)
        self._here = (self._state[index], self._action[index], self._next[index])
        self._here_dt = self._dt[rows]
        self._block = block

    def _tick(self) -> None:
        block, row = divmod(self.clock, _BLOCK)
        if block != self._block:
            self._fetch(block)
        state, action, next_state = (part[row] for part in self._here)
        dt = self._here_dt[row]
        valid = (self._lengths > self.clock).numpy()
        self.clock += 1
        improve = self._schedule is not None and self._schedule.improves(self.clock)
        for seconds, whose in self._lengths_of(dt, valid):
            own = torch.from_numpy(whose).to(self.world.device)
            length = torch.as_tensor(seconds, dtype=self.world.dtype, device=self.world.device)
            transition = Transition(state, action, next_state, length, own)
            self.learners, metrics = self.learner.step(self.learners, transition, improve=improve)
            self._tally = self._tally.add(metrics, own)
        self._seen += np.where(valid, dt, 0.0)

    def _lengths_of(
        self, dt: np.ndarray, valid: np.ndarray
    ) -> list[tuple[np.ndarray | float, np.ndarray]]:
        """How long the transitions ``[B]`` of a tick are, and of which learners, for the steps to
        take: one with everybody's own, where the learners' parts take that, else one for each."""
        known = np.unique(dt[valid])
        if len(known) > 1 and self.learner.dt_per_learner:
            return [(dt, valid)]
        # Learners of another dt are left as they are.
        return [(seconds, valid & (dt == seconds)) for seconds in known.tolist()]

    def climb(self, steps: int) -> int:
        """Up to ``steps`` improvements of the policies that have not arrived, the models being what
        they are; returns how many there were."""
        with self._mode():
            for done in range(steps):
                if not bool(self.moving.any()):
                    return done
                self._climb()
        return steps

    def _climb(self) -> None:
        learner, here = self.learner, self.learners
        known = here.model | learner.estimator.describe(here.fit)
        found = learner.value(known, here.policy, here.noise, self._some_states())
        size = gradient_norm(found.gradient)
        sound = torch.isfinite(found.value + size)
        unit = learner.model.time_unit(self.world.seconds)
        policy, memory = learner.step_rule(here.policy, found.gradient, here.step, unit)
        goes = self.moving & sound
        self.learners = replace(
            here,
            policy=_where(goes, policy, here.policy),
            step=_where(goes, memory, here.step),
        )
        self.learners = replace(self.learners, limit=self._limit(goes))
        unfitted, flags = torch.zeros_like(size), self._flags(sound)
        self._note(Metrics(found.value, size, unfitted, flags, found.first_floored))
        step = gradient_norm({name: policy[name] - here.policy[name] for name in policy})
        self.steps = self.steps + goes
        self.moving = goes & (step > self._tolerance * gradient_norm(policy))

    def _limit(self, goes: Tensor) -> Parameters:
        """The bounds of commands under the new policies."""
        here = self.learners
        if self.learner.command is None:
            return here.limit
        limit = self.learner.command(here.model, here.policy, here.noise, here.tick)
        return {"limit": select(goes, limit, here.limit["limit"])}

    def _flags(self, sound: Tensor) -> Tensor:
        return torch.stack([torch.ones_like(sound), torch.ones_like(sound), sound])

    def _note(self, metrics: Metrics) -> None:
        """Value and gradient count; no transition was predicted."""
        added = self._tally.add(metrics, self.moving)
        self._tally = replace(added, error=self._tally.error, ticks=self._tally.ticks)

    def _some_states(self) -> Tensor:
        """A state of each learner's transitions to unroll from, ``[B, n]``."""
        picked = [
            own[generator.integers(len(own))]
            for own, generator in zip(self._order, self._starts, strict=True)
        ]
        return self._next[torch.tensor(picked, device=self.world.device)]

    def snapshot(self) -> Snapshot:
        """The population now; the means begin anew.  Episodes and failures are those of all of the
        data."""
        sums, learners = self._tally, self.learners
        self._tally = sums.begun_anew()
        squares = [p.flatten(1).square().sum(-1) for p in learners.policy.values()]
        episodes, failures, successes = self._counts
        return Snapshot(
            seconds=self.seconds,
            seeds=self.seeds,
            active=self.moving.tolist(),
            episodes=episodes,
            failures=failures,
            successes=successes,
            episode_seconds=[0.0] * len(self.seeds),
            value=(sums.value / sums.updates).tolist(),
            gradient=(sums.gradient / sums.updates).tolist(),
            error=(sums.error / sums.ticks).tolist(),
            policy_norm=torch.stack(squares).sum(0).sqrt().tolist(),
        )


def _where(mask: Tensor, yes: Parameters, no: Parameters) -> Parameters:
    return {name: select(mask, yes[name], no[name]) for name in no}
