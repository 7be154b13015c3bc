"""Which numbers belong to which seed: the keys of all random streams.

A stream is a pure function of (seed, purpose, tick), so that learner k of a population draws what
it would draw alone.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a stream is for; each purpose is independent of the others."""

    LEARNING = 0
    EVALUATION = 1
    JUDGING = 2
    POLICY = 3
    """The first parameters of a policy."""
    MODEL = 4
    """The first parameters of a model."""
    TRIAL = 5
    """The trials of a search, one episode each."""
    PLAN = 6
    """Where plans start from, by trial."""
    POSTERIOR = 7
    """Drawn models, by trial."""
    STARTS = 8
    """Starts that are only looked at."""
    SOLVED = 9
    """Whether a policy has solved its task."""
    EXPLORING = 10
    """The parameters that are tried in the first trials, by trial."""


def stream_key(seed: int, purpose: Purpose, episode: int = 0) -> tuple[int, int]:
    """Key of the stream of a seed; ``episode`` tells fresh evaluation episodes apart."""
    return seed, (int(purpose) << 32) + episode


def generator_seed(seed: int, purpose: Purpose) -> int:
    """A seed in [0, 2^63) for a generator of torch, from the stream of ``purpose``."""
    key = np.array(stream_key(seed, purpose), dtype=np.uint64)
    return int(np.random.Philox(key=key).random_raw()) >> 1


def numpy_generator(seed: int, purpose: Purpose, episode: int = 0) -> np.random.Generator:
    """A generator of numpy, from the stream of a seed."""
    key = np.array(stream_key(seed, purpose, episode), dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))
