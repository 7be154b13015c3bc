"""Keeping a covariance symmetric and positive semidefinite."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from edtorch.linalg import symmetric_eigen
from edtorch.shapes import Squares

_TOLERANCE = 1e-12
"""Eigenvalues above -_TOLERANCE times the largest count as rounding."""


def symmetric(matrix: Squares) -> Squares:
    """(A + A') / 2, which removes the asymmetry of rounding."""
    return 0.5 * (matrix + matrix.mT)


class Floored(NamedTuple):
    """cov ``[*batch, n, n]``; began ``[*batch]``: whether eigenvalues that were negative beyond
    rounding were set to 0."""

    cov: Tensor
    began: Tensor


def floored(cov: Squares) -> Floored:
    """The nearest positive semidefinite matrix: negative eigenvalues become 0.

    cov ``[*batch, n, n]``, symmetric.  The correction counts as a constant in derivatives,
    since the gradient of the eigenvectors does not exist where eigenvalues coincide, for instance
    at Sigma = 0.  Where nothing was negative beyond rounding, value and gradient are the input's.
    Rows that are not finite are returned unchanged, for the caller's checks to find.
    """
    values, vectors = symmetric_eigen(cov.detach())
    # In float32 rounding itself is larger than _TOLERANCE.
    tolerance = max(_TOLERANCE, 10 * torch.finfo(cov.dtype).eps)
    began = values[..., 0] < -tolerance * values.abs().amax(-1)
    lift = (vectors * (-values).clamp(min=0).unsqueeze(-2)) @ vectors.mT
    return Floored(torch.where(began[..., None, None], symmetric(cov + lift), cov), began)
