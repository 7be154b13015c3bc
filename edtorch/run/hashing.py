"""Uniform numbers as a pure function of (key, counter), in tensor arithmetic.

Where ``edtorch.run.random`` draws on the host, this draws inside a compiled graph and on any
device: nothing but the key and the counter, which the graph has anyway.  A number is the counter,
encrypted twice by a bijective hash of 32-bit words ("lowbias32" with the constants of least bias
found since, C. Wellons, hash-prospector, public domain), once with each word of the key.  It has
32 bits.

Words are int64 tensors in [0, 2^32).  The multipliers are below 2^31, so that no product leaves
int64.
"""

from __future__ import annotations

import math
from enum import IntEnum

import torch
from torch import Tensor

_MASK = 0xFFFFFFFF
_FIRST, _SECOND = 0x21F0AAAD, 0x735A2D97


class Use(IntEnum):
    """What a key is for; each use is independent of the others."""

    WEIGHTS = 1
    EPISODE = 2
    SCENARIO = 3
    FRESH = 4


def mix(word: Tensor) -> Tensor:
    """A bijection of [0, 2^32): every bit of the result depends on every bit of the word."""
    word = word ^ (word >> 16)
    word = (word * _FIRST) & _MASK
    word = word ^ (word >> 15)
    word = (word * _SECOND) & _MASK
    return word ^ (word >> 15)


def hash_key(use: Use, seed: int, *words: Tensor) -> Tensor:
    """Keys ``[*batch, 2]`` (int64) from a seed below 2^63 and words ``[*batch]`` in [0, 2^32)."""
    shape = torch.broadcast_shapes(*(word.shape for word in words))
    device = words[0].device if words else None
    head = [int(use), seed & _MASK, seed >> 32]
    halves = []
    for salt in (0x243F6A88, 0x85A308D3):  # of pi: nothing up the sleeve
        half = torch.full(shape, salt, dtype=torch.int64, device=device)
        for word in (*head, *words):
            half = mix(half ^ word)
        halves.append(half)
    return torch.stack(halves).movedim(0, -1)


def uniform(key: Tensor, counter: Tensor, count: int) -> Tensor:
    """``count`` uniforms ``[*batch, count]`` in [0, 1), float64, independent for every counter.

    key ``[*batch, 2]``; counter ``[*batch]`` int64 in [0, 2^32 / count).
    """
    first, second = key.unbind(-1)
    numbers = []
    for place in range(count):
        word = mix(((counter * count + place) & _MASK) ^ first)
        numbers.append(mix((word + second) & _MASK).to(torch.float64) * 2.0**-32)
    if not numbers:
        return torch.empty((*counter.shape, 0), dtype=torch.float64, device=counter.device)
    return torch.stack(numbers).movedim(0, -1)


def normals(uniforms: Tensor) -> Tensor:
    """As many standard normal numbers ``[*batch, 2 k]`` as there are uniforms, independent if they
    are (Box and Muller, "A note on the generation of random normal deviates", 1958)."""
    first, second = uniforms.chunk(2, dim=-1)
    # 1 - u is above 0.
    radius = (-2 * torch.log1p(-first)).sqrt()
    angle = 2 * math.pi * second
    return torch.cat((radius * angle.cos(), radius * angle.sin()), dim=-1)
