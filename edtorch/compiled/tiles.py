"""Compiled ticks for populations of any size: tile by tile, each small enough for the cache."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from edtorch.compiled.innermost import first, last
from edtorch.compiled.program import Program, compile_tick
from edtorch.learner.schedule import ALWAYS
from edtorch.run.random import Streams, learning_streams
from edtorch.run.tick import Population, Tick
from edtorch.run.training import Moment, Note
from edtorch.types import replace
from sims.base import Outcome

LARGEST_TILE = 256
"""Learners of a tile: what they work with then stays in a core's own cache."""
VECTOR = 16
"""Tiles are multiples of this many, so that every learner is computed by the same instructions."""
PIECE = 16
"""Ticks of one tile before it is the next one's turn, and before anybody looks at what ended."""


def tile_size(learners: int, device: torch.device) -> int:
    """The size of the tiles of a population; the last one may be padded.

    A GPU wants everybody at once: its tile is the population.
    """
    whole = -(-learners // VECTOR) * VECTOR
    return min(LARGEST_TILE, whole) if device.type == "cpu" else whole


def _padded(population: Population, rows: slice, size: int) -> Population:
    """The ``rows`` of a population, and copies of the last of them, which do not learn."""
    index = torch.arange(rows.start, rows.start + size).clamp(max=rows.stop - 1)
    tile: Population = pytree.tree_map(lambda leaf: leaf[index.to(leaf.device)], population)
    own = torch.arange(size, device=tile.worlds.active.device) < rows.stop - rows.start
    return replace(tile, worlds=replace(tile.worlds, active=tile.worlds.active & own))


@dataclass
class _Tile:
    """Some learners; leaves: their ``Population``, stored batch last."""

    rows: slice
    streams: Streams
    leaves: list[Tensor]
    done: bool


class Tiles:
    """A ``Stage`` that runs a program.

    The digits of a learner do not depend on its company: it lies in a tile of its own kind, and
    its tile's program computes every learner alike.
    """

    def __init__(self, tick: Tick, population: Population, seeds: Sequence[int]) -> None:
        """Compile, or fetch what has been compiled before.  Raises CannotCompile."""
        self._size = tile_size(len(seeds), tick.world.device)
        self._tiles: list[_Tile] = []
        for start in range(0, len(seeds), self._size):
            rows = slice(start, min(start + self._size, len(seeds)))
            own = list(seeds[rows])
            streams = learning_streams(tick.world, own + own[-1:] * (self._size - len(own)))
            self._tiles.append(_Tile(rows, streams, [], done=False))
        sample = _padded(population, self._tiles[0].rows, self._size)
        self._schedule, draw = tick.schedule, self._tiles[0].streams.at(0)
        kinds = {True} if self._schedule == ALWAYS else {True, False}
        self._programs: dict[bool, Program] = {
            improve: compile_tick(tick, sample, draw, improve=improve) for improve in kinds
        }
        """By whether policies are improved."""
        self._spec = pytree.tree_flatten(sample)[1]
        places = list(range(self._spec.num_leaves))
        self._place: Population = pytree.tree_unflatten(places, self._spec)
        self.replace(population)

    @property
    def size(self) -> int:
        """Learners of a tile."""
        return self._size

    @property
    def was_compiled(self) -> bool:
        """Whether anything had to be compiled; if not, all was on disk."""
        return any(program.seconds is not None for program in self._programs.values())

    @property
    def population(self) -> Population:
        """See ``Stage``."""
        population = self._population
        if population is None:
            parts = [[first(leaf)[: _length(t)] for leaf in t.leaves] for t in self._tiles]
            leaves = [torch.cat(rows) for rows in zip(*parts, strict=True)]
            population = pytree.tree_unflatten(leaves, self._spec)
            self._population = population
        return population

    @property
    def done(self) -> bool:
        """See ``Stage``."""
        return all(tile.done for tile in self._tiles)

    def replace(self, population: Population) -> None:
        """See ``Stage``."""
        self._population: Population | None = population
        for tile in self._tiles:
            part = _padded(population, tile.rows, self._size)
            tile.leaves = [last(leaf).clone() for leaf in pytree.tree_leaves(part)]
            tile.done = not bool(part.worlds.active.any())

    def run(self, clock: int, ticks: int, stride: int, note: Note) -> int:
        """See ``Stage``; it stops at the end of a piece."""
        for began in range(clock, clock + ticks, PIECE):
            piece = min(PIECE, clock + ticks - began)
            for tile in self._tiles:
                if not tile.done:
                    note(self._live(tile, began, piece, stride))
                    tile.done = not bool(tile.leaves[_at(self._place.worlds.active)].any())
            self._population = None
            if self.done:
                return began + piece - clock
        return ticks

    def _live(self, tile: _Tile, clock: int, ticks: int, stride: int) -> list[Moment]:
        """Run a tile for a while; returns what is worth a note."""
        width = len(tile.leaves)
        worlds = self._place.worlds
        start, begun = _at(worlds.start), _at(worlds.begun)
        episodes, active = _at(worlds.episodes), _at(worlds.active)
        clocks = torch.arange(clock + 1, clock + ticks + 1, device=tile.leaves[0].device)
        leaves, moments = tile.leaves, []
        for offset in range(ticks):
            uniform, normal = tile.streams.stored(clock + offset + 1)
            before = leaves
            improve = self._schedule.improves(clock + offset + 1)
            found = self._programs[improve].run([*leaves, uniform, normal, clocks[offset]])
            leaves = found[:width]
            # All but these are let go at once, so that their memory is used again.
            moments.append(
                (before[start], before[begun], before[episodes], before[active], *found[width:])
            )
        tile.leaves = leaves
        ended = (torch.stack([m[4] for m in moments]) != int(Outcome.RUNNING)).any(-1).tolist()
        return [
            Moment(
                clock=now,
                rows=tile.rows,
                start=first(m[0]),
                begun=m[1],
                episodes=m[2],
                active=m[3],
                world=first(m[5]),
                earned=m[6],
                outcome=m[4],
            )
            for now, m, any_ended in zip(
                range(clock + 1, clock + ticks + 1), moments, ended, strict=True
            )
            if any_ended or (tile.rows.start == 0 and now % stride == 0)
        ]


def _length(tile: _Tile) -> int:
    return tile.rows.stop - tile.rows.start


def _at(place: Tensor) -> int:
    """``place`` of a tree that holds places instead of tensors."""
    return int(place)
