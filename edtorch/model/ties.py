"""Features that are sums of terms: one weight for all of a sum.

What is known of a system may say in which proportion terms occur, such as those of
cos(a - b) = cos a cos b + sin a sin b.  A regression then has a weight for each sum, and fewer of
them; the model has those of its terms, and is computed as any other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from edtorch.model.evidence import Evidence, Posterior


@dataclass(frozen=True, eq=False)
class Ties:
    """F features of K terms: feature = share phi.

    share: float64 ``[F, K]``; allowed: bool ``[L, F]``, the features that each output may have.
    """

    share: np.ndarray
    allowed: np.ndarray


def tied(evidence: Evidence, ties: Ties) -> Evidence:
    """``evidence`` for the features of ``ties``; its posterior is that of the terms' weights, whose
    covariance has the rank of the features.  What it is told to be allowed is not asked for."""
    share, own = torch.from_numpy(ties.share), torch.from_numpy(ties.allowed)

    def found(X: Tensor, y: Tensor, weight: Tensor, allowed: Tensor) -> Posterior:
        posterior = evidence(X @ share.mT, y, weight, own)
        return replace(
            posterior,
            weight=posterior.weight @ share,
            cov=share.mT @ posterior.cov @ share,
        )

    return found
