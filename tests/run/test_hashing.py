"""The uniforms of the graph: uniform, independent, and a function of key and counter alone."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.run.hashing import Use, hash_key, mix, uniform

KEYS, TICKS = 200, 5000


def _numbers(count: int = 1, seed: int = 0) -> Tensor:
    """``[KEYS, TICKS, count]``: neighbouring keys, neighbouring counters."""
    key = hash_key(Use.EPISODE, seed, torch.arange(KEYS), torch.zeros(KEYS, dtype=torch.int64))
    return uniform(key[:, None], torch.arange(TICKS).expand(KEYS, -1), count)


def test_mix_is_a_bijection_with_avalanche() -> None:
    generator = torch.Generator().manual_seed(0)
    words = torch.randint(2**32, (2**16,), generator=generator).unique()
    assert len(mix(words).unique()) == len(words)
    for bit in range(32):
        flipped = mix(words) ^ mix(words ^ (1 << bit))
        share = torch.stack([((flipped >> b) & 1).double().mean() for b in range(32)])
        assert float((share - 0.5).abs().max()) < 0.02


def test_moments() -> None:
    """Mean 1/2, variance 1/12, within five standard errors."""
    u = _numbers()
    n = u.numel()
    assert float(u.min()) >= 0 and float(u.max()) < 1
    assert abs(float(u.mean()) - 1 / 2) < 5 * (1 / 12 / n) ** 0.5
    assert abs(float(u.var()) - 1 / 12) < 5 * (1 / 180 / n) ** 0.5


@pytest.mark.parametrize("bits", [0, 8, 16, 24])
def test_every_byte_is_uniform(bits: int) -> None:
    """Chi-square with 255 degrees of freedom: mean 255, standard deviation 22.6."""
    byte = ((_numbers() * 2**32).long() >> bits) & 255
    found = torch.bincount(byte.flatten(), minlength=256).double()
    expected = byte.numel() / 256
    assert abs(float(((found - expected) ** 2 / expected).sum()) - 255) < 5 * 22.6


def test_neighbours_are_uncorrelated() -> None:
    """In time, between keys, between places of one tick, and between seeds."""
    u = _numbers(2) - 0.5
    other = _numbers(2, seed=1) - 0.5
    pairs = [
        *((u[:, lag:, 0], u[:, :-lag, 0]) for lag in (1, 2, 3, 16, 64)),
        *((u[lag:, :, 0], u[:-lag, :, 0]) for lag in (1, 2, 29)),
        (u[..., 0], u[..., 1]),
        (u, other),
    ]
    for one, two in pairs:
        correlation = float((one * two).mean()) * 12
        assert abs(correlation) < 5 / one.numel() ** 0.5


def test_runs_of_a_policy_are_other_episodes() -> None:
    policy, run = torch.meshgrid(torch.arange(300), torch.arange(30), indexing="ij")
    key = hash_key(Use.EPISODE, 7, policy, run)
    assert len(key.flatten(0, 1).unique(dim=0)) == 300 * 30
    assert not hash_key(Use.WEIGHTS, 7, policy).equal(key)
    assert not hash_key(Use.EPISODE, 7 + 2**40, policy, run).equal(key)


def test_numbers_do_not_depend_on_the_batch() -> None:
    key = hash_key(Use.EPISODE, 3, torch.arange(10))
    alone = uniform(key[4], torch.tensor(17), 3)
    assert uniform(key, torch.full((10,), 17), 3)[4].equal(alone)
    assert uniform(key, torch.zeros(10, dtype=torch.int64), 0).shape == (10, 0)
