"""Linear algebra of a population's small matrices, of which some may be broken."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.shapes import Squares, States


def symmetric_eigen(matrix: Squares) -> tuple[States, Squares]:
    """Eigenvalues ``[*batch, n]``, rising, and eigenvectors of symmetric ``[*batch, n, n]``.

    NaN for a matrix that is not finite: ``torch.linalg.eigh`` would raise, for the whole batch, and
    one learner's trouble is not another's.
    """
    finite = matrix.isfinite().all(-1).all(-1)
    values, vectors = torch.linalg.eigh(torch.where(finite[..., None, None], matrix, 0.0))
    return torch.where(finite[..., None], values, torch.nan), vectors


def matvec(matrix: Tensor, vector: Tensor) -> Tensor:
    """``[*batch, n, k]`` times ``[*batch, k]`` -> ``[*batch, n]``."""
    column = vector.unsqueeze(-1)
    # What ``@`` finds out first costs more than the product, in the loop of a small population.
    flat = matrix.ndim == 3 and column.ndim == 3 and matrix.shape[0] == column.shape[0]
    return (torch.bmm(matrix, column) if flat else matrix @ column).squeeze(-1)


def solve_positive(A: Tensor, Y: Tensor) -> Tensor:
    """A^-1 Y by Gauss and Jordan, A ``[B, m, m]`` positive definite and small, Y ``[B, m, k]``.

    Elementwise operations only, which a compiler does for many learners side by side; positive
    definite matrices need no pivoting.
    """
    m = A.shape[-1]
    rows = torch.cat([A, Y], dim=-1)
    for p in range(m):
        pivot = rows[:, p : p + 1] / rows[:, p : p + 1, p : p + 1]
        own = (torch.arange(m, device=A.device) == p).view(1, m, 1)
        rows = torch.where(own, pivot, rows - rows[:, :, p : p + 1] * pivot)
    return rows[:, :, m:]
