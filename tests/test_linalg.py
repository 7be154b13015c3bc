"""Eigenvalues where some matrices of the batch are broken."""

from __future__ import annotations

import torch

from edtorch.linalg import symmetric_eigen
from tests.systems import normal, random_cost


def test_broken_matrices_are_nan_and_the_others_their_own() -> None:
    g = torch.Generator().manual_seed(0)
    sound = random_cost(g, 3)
    batch = torch.stack([sound, sound.clone(), normal(g, 3, 3)])
    batch[1, 0, 2] = float("inf")
    batch[2, 1, 1] = float("nan")
    values, vectors = symmetric_eigen(batch)
    assert torch.allclose(vectors[0] * values[0] @ vectors[0].T, sound, rtol=1e-12)
    assert values.isnan().all(-1).tolist() == [False, True, True]
