"""Eigenvalues of a population's matrices, of which some may be broken."""

from __future__ import annotations

import torch
from torch import Tensor


def symmetric_eigen(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues ``[*batch, n]``, rising, and eigenvectors of symmetric ``[*batch, n, n]``.

    NaN for a matrix that is not finite: ``torch.linalg.eigh`` would raise, for the whole batch, and
    one learner's trouble is not another's.
    """
    finite = matrix.isfinite().all(-1).all(-1)
    values, vectors = torch.linalg.eigh(torch.where(finite[..., None, None], matrix, 0.0))
    return torch.where(finite[..., None], values, torch.nan), vectors
