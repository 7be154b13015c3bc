r"""Bayesian linear regression whose priors and noise maximise the evidence.

y = X w + e, e_n ~ N(0, 1 / (beta share_n)), w_d ~ N(0, 1 / alpha_d).  MacKay's updates ("Bayesian
interpolation", 1992) climb the evidence p(y | alpha, beta): with P = (diag(alpha) + beta X'SX)^-1,
w = beta P X'S y and gamma_d = 1 - alpha_d P_dd, the share of w_d that the data determine,

    alpha_d = gamma_d / w_d^2,   beta = (N - sum gamma) / r'S r,   r = y - X w.

One alpha for each weight prunes those that the data do not ask for (automatic relevance
determination; Tipping, "Sparse Bayesian learning and the relevance vector machine", 2001); one for
all is ridge regression.  Columns of X and y are divided by their weighted root mean squares first,
so that units change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.linalg import matvec

_LEAST, _MOST = 1e-6, 1e8
"""Bounds of alpha, beside columns and y of mean square 1."""
_PRIOR_AT_START = 0.01
"""Mean square of the predictions before any data, beside y's: alpha starts at K times its inverse.
Where there are nearly as many columns as rows, a start with wide priors ends in weights that
interpolate the rows, another optimum of the evidence."""
_LEAST_NOISE = 1e-8
"""Share of y's mean square that is noise, at least."""
_LEAST_LEFT = 1e-6
"""Share of the rows that the weights leave undetermined, at least: rounding may say none."""
_JITTER = 1e-12
"""What the diagonal of P^-1 grows by, relatively: Cholesky's method asks for it where columns are
linearly dependent and the noise is small."""


@dataclass(frozen=True)
class Posterior:
    """N(weight, cov) of the weights of each of L outputs, independent of each other.

    weight ``[L, K]``, cov ``[L, K, K]``, noise ``[L]``: variance of an output's error, in a row of
    share 1.  fallbacks: rows without a path of their own (``edtorch.model.path_fit``).
    """

    weight: Tensor
    cov: Tensor
    noise: Tensor
    fallbacks: int = 0

    def drawn(self, normals: Tensor, inflation: float = 2.0) -> Tensor:
        """Weights ``[*batch, L, K]`` from standard normal numbers of that shape, with standard
        deviations times ``inflation``: a posterior that knows no error of the model is too sure."""
        deviation = self.cov.diagonal(dim1=-2, dim2=-1).sqrt()
        divisor = torch.where(deviation > 0, deviation, 1.0)
        correlation = self.cov / (divisor.unsqueeze(-1) * divisor.unsqueeze(-2))
        eye = torch.eye(self.cov.shape[-1], dtype=self.cov.dtype)
        # Weights that are zero by definition have no deviation; rounding asks for the rest.
        root = torch.linalg.cholesky(
            correlation + torch.diag_embed(1.0 * (deviation == 0)) + 1e-9 * eye
        )
        return self.weight + inflation * deviation * matvec(root, normals)


Evidence = Callable[[Tensor, Tensor, Tensor, Tensor], Posterior]
"""(X, y, share, allowed) -> Posterior: ``ard`` or ``ridge``."""


@dataclass(frozen=True)
class Updates:
    """How the evidence is climbed: ``count`` updates from ``noise``, the share of y's mean square
    that is noise.  The evidence has several maxima where there are fewer rows than columns: a start
    with little noise ends in those that explain nearly all of y, as is right for exact readings."""

    count: int = 30
    noise: float = 0.1


UPDATES = Updates()


def ard(
    X: Tensor, y: Tensor, share: Tensor, allowed: Tensor, updates: Updates = UPDATES
) -> Posterior:
    """One alpha for each weight.

    X ``[N, K]``, y ``[L, N]``, share ``[L, N]`` (weights of the rows, 0 or more), allowed bool
    ``[L, K]`` (weights that are not 0 by definition).  Raises FitError where the numbers break.
    """
    return _maximised(X, y, share, allowed, updates, lambda gamma, square: gamma / square)


def ridge(
    X: Tensor, y: Tensor, share: Tensor, allowed: Tensor, updates: Updates = UPDATES
) -> Posterior:
    """One alpha for all weights of an output; arguments as for ``ard``."""
    return _maximised(
        X,
        y,
        share,
        allowed,
        updates,
        lambda gamma, square: gamma.sum(-1, keepdim=True) / square.sum(-1, keepdim=True),
    )


def _maximised(
    X: Tensor,
    y: Tensor,
    share: Tensor,
    allowed: Tensor,
    updates: Updates,
    precision: Callable[[Tensor, Tensor], Tensor],
) -> Posterior:
    """precision: alpha from gamma and w^2, both ``[L, K]``."""
    mean = share.mean(-1, keepdim=True)
    unit = _positive(((share * y.square()).mean(-1, keepdim=True) / mean).sqrt())
    scale = _positive((share @ X.square() / X.shape[0] / mean).sqrt())
    columns = X / scale.unsqueeze(-2) * allowed.unsqueeze(-2)
    target = y / unit
    shared = columns * share.unsqueeze(-1)
    gram, moment = shared.mT @ columns, matvec(shared.mT, target)
    rows = X.shape[0]
    alpha = torch.full_like(moment, X.shape[1] / _PRIOR_AT_START).clamp(_LEAST, _MOST)
    beta = 1 / (updates.noise * mean)
    for _ in range(updates.count):
        cov, w = _posterior(gram, moment, alpha, beta)
        gamma = (1 - alpha * cov.diagonal(dim1=-2, dim2=-1)).clamp(0, 1)
        error = (share * (target - matvec(columns, w)).square()).sum(-1, keepdim=True)
        left = (rows - gamma.sum(-1, keepdim=True)).clamp(min=_LEAST_LEFT * rows)
        beta = left / torch.maximum(error, left * _LEAST_NOISE * mean)
        # A weight of a column that is always 0 is 0, and so is its gamma: nothing asks for it.
        asked = precision(gamma, w.square()).nan_to_num(_MOST, _MOST)
        alpha = asked.clamp(_LEAST, _MOST).expand_as(moment)
    cov, w = _posterior(gram, moment, alpha, beta)
    factor = unit / scale * allowed
    found = Posterior(
        w * factor,
        cov * factor.unsqueeze(-1) * factor.unsqueeze(-2),
        (unit.square() / beta).squeeze(-1),
    )
    numbers = (scale, found.weight, found.cov, found.noise)
    if not all(bool(part.isfinite().all()) for part in numbers):
        raise FitError(
            f"the fit broke: {rows} transitions leave weights or a noise that are not finite;"
            " expected data of moderate size (scales of the state: sims.base.Quantity.scale)"
        )
    return found


def _posterior(gram: Tensor, moment: Tensor, alpha: Tensor, beta: Tensor) -> tuple[Tensor, Tensor]:
    """P ``[L, K, K]`` and w ``[L, K]``; NaN where the matrix is not positive definite."""
    matrix = beta.unsqueeze(-1) * gram
    matrix.diagonal(dim1=-2, dim2=-1).add_(alpha).mul_(1 + _JITTER)
    factor, failed = torch.linalg.cholesky_ex(matrix)
    cov = torch.cholesky_inverse(factor)
    cov = torch.where((failed == 0)[..., None, None], cov, torch.nan)
    return cov, beta * matvec(cov, moment)


def _positive(scale: Tensor) -> Tensor:
    return torch.where(scale > 0, scale, 1.0)
