"""Feature maps: what they compute, and that they know their size."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.model.features import (
    Affine,
    FeatureMap,
    Identity,
    Pairwise,
    RandomFourier,
    Trigonometric,
)
from tests.systems import normal


def fourier(inputs: int, count: int = 6) -> RandomFourier:
    return RandomFourier(inputs, count, 0.7, torch.Generator().manual_seed(0))


MAPS = {
    "identity": Identity,
    "affine": Affine,
    "pairwise": Pairwise,
    "trigonometric": Trigonometric,
    "fourier": fourier,
}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("shape", [(), (1,), (4, 2)])
def test_size_and_rows(name: str, shape: tuple[int, ...]) -> None:
    features: FeatureMap = MAPS[name](3)
    x = normal(torch.Generator().manual_seed(1), *shape, 3)
    out = features(x)
    assert out.shape == (*shape, features.outputs)
    rows = torch.stack([features(row) for row in x.reshape(-1, 3)])
    assert torch.allclose(out.reshape(-1, features.outputs), rows, rtol=1e-14, atol=1e-15)
    assert features(x.float()).dtype == torch.float32


def test_values() -> None:
    x = torch.tensor([2.0, -3.0], dtype=torch.float64)
    assert Identity(2)(x).tolist() == [2, -3]
    assert Affine(2)(x).tolist() == [1, 2, -3]
    assert Pairwise(2)(x).tolist() == [1, 2, -3, 4, -6, 9]
    sines = [math.sin(2 * math.pi), math.sin(-3 * math.pi)]
    cosines = [math.cos(2 * math.pi), math.cos(-3 * math.pi)]
    assert Trigonometric(2)(x).tolist() == pytest.approx([1, 2, -3, *sines, *cosines])


def test_fourier_inner_products_approach_a_squared_exponential_kernel() -> None:
    count, lengthscale = 20_000, 1.3
    features = RandomFourier(2, count, lengthscale, torch.Generator().manual_seed(3))
    x = torch.tensor([[0.0, 0.0], [0.5, -0.2], [1.5, 1.0]], dtype=torch.float64)
    waves: Tensor = features(x)[:, 3:]
    kernel = torch.exp(-torch.cdist(x, x).square() / (2 * lengthscale**2))
    assert torch.allclose(waves @ waves.T, kernel, atol=6 / math.sqrt(count))


def test_same_generator_same_map() -> None:
    x = torch.ones(2, dtype=torch.float64)
    assert torch.equal(fourier(2)(x), fourier(2)(x))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((0, 3, 1.0), "inputs=0"), ((2, 0, 1.0), "count=0"), ((2, 3, 0.0), "lengthscale=0.0")],
)
def test_refuses_the_impossible(arguments: tuple[int, int, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RandomFourier(*arguments, torch.Generator())
