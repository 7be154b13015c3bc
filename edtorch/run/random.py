"""Random numbers as a pure function of (seed, purpose, tick).

Each learner has a stream of its own: NumPy's counter-based Philox generator with the key
(seed, purpose) and the number of a block of ticks as its counter (Salmon et al., "Parallel random
numbers: as easy as 1, 2, 3", 2011).  Nothing has to be saved to continue a stream, and learner k of
a population draws what it would draw alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.run.scaled_sim import World
from edtorch.seeding import Purpose as Purpose
from edtorch.seeding import stream_key as stream_key

BLOCK = 512
"""Ticks drawn at once.  Part of the stream's definition: another value gives other numbers."""


_AT_ONCE = 4096


@dataclass(frozen=True)
class Draw:
    """The numbers of one tick: uniform ``[B, u]`` in [0, 1), normal ``[B, v]`` standard normal."""

    uniform: Tensor
    normal: Tensor


def draw_block(
    keys: Sequence[tuple[int, int]], uniforms: int, normals: int, block: int
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """The numbers of the ticks ``block`` BLOCK, ..., uniform ``[B, BLOCK, uniforms]`` and standard
    normal ``[B, BLOCK, normals]``."""
    uniform = np.empty((len(keys), BLOCK, uniforms))
    normal = np.empty((len(keys), BLOCK, normals))
    for row, key in enumerate(keys):
        word = np.array(key, dtype=np.uint64)
        generator = np.random.Generator(np.random.Philox(key=word, counter=[0, 0, 0, block]))
        generator.random(out=uniform[row])
        generator.standard_normal(out=normal[row])
    return uniform, normal


class Streams:
    """The streams of a population, read tick by tick.

    keys: one (word, word) per row of the batch, see ``stream_key``; uniforms, normals: how many
    numbers of each kind a tick takes.
    """

    def __init__(
        self,
        keys: Sequence[tuple[int, int]],
        uniforms: int,
        normals: int,
        dtype: torch.dtype = torch.float64,
        device: torch.device | None = None,
    ) -> None:
        self._keys = keys
        self._uniforms = uniforms
        self._normals = normals
        self._dtype = dtype
        self._device = device
        self._block = -1
        self._uniform = torch.empty(0)
        self._normal = torch.empty(0)

    def at(self, tick: int) -> Draw:
        """The numbers of ``tick`` (any order of ticks is allowed; rising order is fast)."""
        uniform, normal = self.stored(tick)
        return Draw(uniform.movedim(0, -1), normal.movedim(0, -1))

    def stored(self, tick: int) -> tuple[Tensor, Tensor]:
        """The same as it is stored, with the batch last: ``[u, B]`` and ``[v, B]``."""
        block, row = divmod(tick, BLOCK)
        if block != self._block:
            self._fill(block)
        return self._uniform[row], self._normal[row]

    def _fill(self, block: int) -> None:
        uniform, normal = draw_block(self._keys, self._uniforms, self._normals, block)
        self._uniform, self._normal = self._laid_out(uniform), self._laid_out(normal)
        self._block = block

    def _laid_out(self, numbers: np.ndarray) -> Tensor:
        """``[B, BLOCK, k]`` as it is stored: ``[BLOCK, k, B]``, the population innermost."""
        turned = torch.from_numpy(numbers).to(self._dtype).permute(1, 2, 0).contiguous()
        return turned.to(self._device)


def learning_keys(seeds: Sequence[int]) -> list[tuple[int, int]]:
    """Of the streams of the learners of these seeds."""
    return [stream_key(seed, Purpose.LEARNING) for seed in seeds]


def starting_numbers(world: World, seeds: Sequence[int]) -> Tensor:
    """The uniform numbers of tick 0 ``[B, u]``, drawn for some learners at a time: the block of a
    whole population would be the largest thing in memory."""
    parts = []
    for first in range(0, len(seeds), _AT_ONCE):
        keys = learning_keys(seeds[first : first + _AT_ONCE])
        streams = Streams(keys, world.uniforms, 0, world.dtype, world.device)
        parts.append(streams.stored(0)[0])
    return torch.cat(parts, dim=-1).movedim(0, -1)


def learning_streams(world: World, seeds: Sequence[int]) -> Streams:
    """What the learners of these seeds draw."""
    keys, normals = learning_keys(seeds), len(world.spec.action)
    return Streams(keys, world.uniforms, normals, world.dtype, world.device)
