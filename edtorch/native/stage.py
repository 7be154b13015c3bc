"""Ticks of a population as one compiled loop, group by group."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch

from edtorch.compiled import load_kernel
from edtorch.native.layout import RowLayout
from edtorch.native.plan import KernelPlan
from edtorch.native.source import source_of
from edtorch.run.random import BLOCK, draw_block, learning_keys
from edtorch.run.tick import Population, Tick
from edtorch.run.training import WATCHED, EndedEpisodes, Note, TrailPoints
from edtorch.types import LearnerState

LANES = 32
"""Learners of a group, side by side in memory."""
_FEW = 16
"""A smaller population is computed one by one."""
_EVENTS = 1024
"""Episodes of a group that can end before somebody takes them."""
_LOOK = 500_000
"""Learner ticks, about, after which somebody looks whether to stop: a second or so."""

_Array = np.ndarray[Any, Any]


def lanes_for(plan: KernelPlan, learners: int) -> int:
    """Learners side by side; 1 where the loops over rows are too long to be unrolled."""
    is_small = plan.constants["A"] <= 8 and plan.constants["K"] <= 12
    return LANES if is_small and learners >= _FEW else 1


@dataclass
class _Slice:
    """Groups that one thread computes, with scratch of its own.

    first: number of its first learner; draws: the numbers of a block of ticks.
    """

    groups: range
    keys: list[tuple[int, int]]
    scratch: _Array
    tape: _Array
    events: _Array
    block: int = -1
    draws: tuple[_Array, _Array] = field(default_factory=lambda: (np.empty(0), np.empty(0)))


class Native:
    """A ``Stage`` of compiled ticks.

    A learner's digits do not depend on its company, on the lanes, or on the threads: they differ
    from those of ``edtorch.run.training.Eager`` by rounding.
    """

    def __init__(
        self,
        plan: KernelPlan,
        tick: Tick[LearnerState],
        population: Population[LearnerState],
        seeds: Sequence[int],
        *,
        threads: int = 1,
        lanes: int | None = None,
    ) -> None:
        """Compile, or fetch what has been compiled before.  Raises Unavailable.

        lanes: for tests; None: as many as is fast.
        """
        self._size = len(seeds)
        self._lanes = lanes = lanes_for(plan, self._size) if lanes is None else lanes
        self._layout = RowLayout.of(population)
        source, self._number, self._constants = source_of(plan, tick.world.sim, lanes)
        places = plan.number()[0]
        self._stride = places["STRIDE"]
        self._width = plan.constants["WIDTH"]
        self._active = plan.constants["ACTIVE"]
        self._drawn = (tick.world.uniforms, len(tick.world.spec.action))
        self.replace(population)
        groups, keys = len(self._numbers), learning_keys(seeds)
        keys += keys[-1:] * (groups * lanes - self._size)
        share = -(-groups // threads)
        steps = int(plan.numbers["STEPS"])
        self._slices = [
            _Slice(
                groups=range(first, min(first + share, groups)),
                keys=keys[first * lanes : (first + share) * lanes],
                scratch=np.zeros(plan.constants["SCRATCH"] * lanes),
                tape=np.zeros((steps + 1) * plan.constants["TAPE"] * lanes),
                events=np.zeros((_EVENTS, 6 + 2 * self._width)),
            )
            for first in range(0, groups, share)
        ]
        self._trail = np.zeros((0, lanes, self._width + 1))
        self._pool = ThreadPoolExecutor(len(self._slices)) if len(self._slices) > 1 else None
        what = f"the tick of {tick.world.spec.name}"
        arguments = self._arguments(self._slices[0], 0, 0, 1, 1, self._trail)
        (self._ticks,) = load_kernel(source, {"ticks": arguments}, what)

    def _arguments(
        self, part: _Slice, group: int, row: int, clock: int, count: int, trail: _Array
    ) -> tuple[Any, ...]:
        uniform, normal = part.draws if part.block >= 0 else _nothing(self._drawn, self._lanes)
        own = slice((group - part.groups.start) * self._lanes, None)
        return (
            self._numbers[group].reshape(-1),
            self._counters[group].reshape(-1),
            part.scratch,
            part.tape,
            self._number,
            self._constants,
            uniform[own],
            normal[own],
            row,
            clock,
            count,
            group * self._lanes,
            part.events,
            trail,
        )

    @property
    def piece(self) -> int:
        """See ``Stage``."""
        return max(16, min(4096, _LOOK // self._size))

    @property
    def population(self) -> Population[LearnerState]:
        """See ``Stage``."""
        return self._layout.unpack(self._numbers, self._counters, self._size)

    @property
    def done(self) -> bool:
        """See ``Stage``."""
        return not self._counters[:, self._active].any()

    def replace(self, population: Population[LearnerState]) -> None:
        """See ``Stage``."""
        self._numbers, self._counters = self._layout.pack(population, self._lanes)

    def run(self, clock: int, ticks: int, stride: int, note: Note) -> int:
        """See ``Stage``."""
        self._number[self._stride] = stride
        began = clock
        while clock < began + ticks and not self.done:
            row = (clock + 1) % BLOCK
            count = min(began + ticks - clock, BLOCK - row)
            share = partial(self._run, clock=clock, count=count, stride=stride)
            parts = list(
                map(share, self._slices)
                if self._pool is None
                else self._pool.map(share, self._slices)
            )
            longest = max(done for done, _, _ in parts)
            trails = [trail for _, _, own in parts for trail in own]
            note(
                self._passed(clock, longest, stride, trails),
                self._ended([events for _, events, _ in parts]),
            )
            clock += longest
        return clock - began

    def _run(
        self, part: _Slice, clock: int, count: int, stride: int
    ) -> tuple[int, _Array, list[_Array]]:
        """Some ticks of a slice: how many, events, and the trails of its groups that have one."""
        block, row = divmod(clock + 1, BLOCK)
        if part.block != block:
            part.draws, part.block = draw_block(part.keys, *self._drawn, block), block
        longest, events, trails = 0, [], []
        passing = (clock + count) // stride - clock // stride
        for group in part.groups:
            watched = group * self._lanes < min(WATCHED, self._size)
            trail = np.zeros((passing if watched else 0, self._lanes, self._width + 1))
            now = 0
            while now < count and self._counters[group, self._active].any():
                rest = trail[(clock + now) // stride - clock // stride :]
                done, ended = self._ticks(
                    *self._arguments(part, group, row + now, clock + now, count - now, rest)
                )
                events.append(part.events[:ended].copy())
                now += done
            longest = max(longest, now)
            if watched:
                trails.append(trail)
        found = np.concatenate(events) if events else part.events[:0]
        return longest, found, trails

    def _passed(
        self, clock: int, longest: int, stride: int, trails: Sequence[_Array]
    ) -> TrailPoints | None:
        clocks = range(clock - clock % stride + stride, clock + longest + 1, stride)
        if not clocks:
            return None
        found = np.concatenate(trails, axis=1)[: len(clocks), : min(WATCHED, self._size)]
        trail = torch.from_numpy(found)
        return TrailPoints(clocks, trail[..., :-1], trail[..., -1] != 0)

    def _ended(self, parts: Sequence[_Array]) -> EndedEpisodes | None:
        events = np.concatenate(parts)
        if not len(events):
            return None
        events = events[np.lexsort((events[:, 1], events[:, 0]))]
        whole = events[:, :5].astype(np.int64)
        states = torch.from_numpy(events[:, 6:])
        return EndedEpisodes(
            clocks=whole[:, 0].tolist(),
            rows=whole[:, 1].tolist(),
            begun=whole[:, 3].tolist(),
            numbers=whole[:, 4].tolist(),
            start=states[:, : self._width],
            final=states[:, self._width :],
            outcome=torch.from_numpy(whole[:, 2].copy()),
            earned=torch.from_numpy(events[:, 5].copy()),
        )


def _nothing(drawn: tuple[int, int], lanes: int) -> tuple[_Array, _Array]:
    return np.zeros((lanes, 1, drawn[0])), np.zeros((lanes, 1, drawn[1]))
