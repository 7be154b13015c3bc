"""Random numbers are a function of (seed, purpose, tick), and look random."""

from __future__ import annotations

import math

import pytest
import torch

from edtorch.run.random import BLOCK, Purpose, Streams, stream_key


def learning(seeds: list[int], uniforms: int = 2, normals: int = 3) -> Streams:
    return Streams([stream_key(s, Purpose.LEARNING) for s in seeds], uniforms, normals)


def test_a_learner_draws_the_same_in_any_company_and_order() -> None:
    together, alone = learning([5, 6, 7]), learning([6])
    for tick in (0, 1, BLOCK - 1, BLOCK, 7 * BLOCK + 3, 2):
        a, b = together.at(tick), alone.at(tick)
        assert torch.equal(a.uniform[1], b.uniform[0])
        assert torch.equal(a.normal[1], b.normal[0])


def test_seeds_purposes_episodes_and_blocks_differ() -> None:
    keys = [
        stream_key(0, Purpose.LEARNING),
        stream_key(1, Purpose.LEARNING),
        stream_key(0, Purpose.EVALUATION),
        stream_key(0, Purpose.EVALUATION, 1),
    ]
    streams = Streams(keys, 1, 0)
    numbers = [float(u) for tick in (0, 1, BLOCK) for u in streams.at(tick).uniform[:, 0]]
    assert len(set(numbers)) == len(numbers)


def test_moments() -> None:
    streams = learning(list(range(20)))
    ticks = 3 * BLOCK
    uniform = torch.stack([streams.at(t).uniform for t in range(ticks)])
    normal = torch.stack([streams.at(t).normal for t in range(ticks)])
    count = uniform.numel()
    assert 0 <= float(uniform.min()) and float(uniform.max()) < 1
    assert float(uniform.mean()) == pytest.approx(0.5, abs=5 * math.sqrt(1 / 12 / count))
    assert float(normal.mean()) == pytest.approx(0, abs=5 / math.sqrt(normal.numel()))
    assert float(normal.var()) == pytest.approx(1, abs=5 * math.sqrt(2 / normal.numel()))
    # Neighbouring seeds and neighbouring ticks are uncorrelated.
    across = torch.corrcoef(normal[:, :, 0].T)
    assert float((across - torch.eye(20)).abs().max()) < 6 / math.sqrt(ticks)
    assert abs(float((normal[1:] * normal[:-1]).mean())) < 5 / math.sqrt(normal.numel())
