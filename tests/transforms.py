"""The one list of transforms over which tests run."""

from __future__ import annotations

import pytest
import torch

from edtorch.transform import (
    Cubature,
    FirstOrder,
    GaussHermite,
    MeanOnly,
    MonteCarlo,
    SecondOrder,
    Transform,
)


def transforms(states: int, *, mean_only: bool = False, monte_carlo: bool = True) -> list:
    """All transforms for ``states`` variables, as parameters of a test."""
    generator = torch.Generator().manual_seed(0)
    every: list[Transform] = [FirstOrder(), SecondOrder(), Cubature(), GaussHermite(3)]
    if monte_carlo:
        every.append(MonteCarlo(200, states, generator))
    if mean_only:
        every.insert(0, MeanOnly())
    return [pytest.param(transform, id=type(transform).__name__) for transform in every]
