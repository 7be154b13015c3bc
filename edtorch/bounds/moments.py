r"""Fourth moments, and the law of the first state as the error recursion needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from edtorch.bounds.constants import require_bound


def fourth_moment(cov: Tensor, kurtosis: float = 3.0) -> float:
    r"""$E|w|^4 = (\mathrm{tr}\,C)^2 + (k - 1)|C|_F^2$ for w of mean 0 and covariance C ``[n, n]``.

    For Gaussian w (k = 3, any C), or w = U diag(sqrt v) z with U orthogonal and independent z_i
    of mean 0, variance 1 and kurtosis k.

    >>> import torch
    >>> fourth_moment(torch.eye(2, dtype=torch.float64))
    8.0
    """
    trace = cov.diagonal().sum().item()
    return trace * trace + (kurtosis - 1) * (cov * cov).sum().item()


def gaussian_fourth_moment(offset: Tensor, cov: Tensor) -> float:
    r"""$E|d|^4$ for $d \sim N(e, C)$; offset e ``[n]``, cov C ``[n, n]``.

    $(\mathrm{tr}\,C)^2 + 2\,\mathrm{tr}\,C^2 + 2\,\mathrm{tr}\,C\,|e|^2 + 4 e'Ce + |e|^4$.
    """
    trace = cov.diagonal().sum().item()
    square = (offset @ offset).item()
    mixed = 2 * trace * square + 4 * (offset @ cov @ offset).item()
    return fourth_moment(cov) + mixed + square * square


@dataclass(frozen=True)
class StartLaw:
    """The first state's law relative to the first belief (s~_0, Sigma~_0).

    mean_error |E s_0 - s~_0|, cov_error |cov s_0 - Sigma~_0|_F, second_moment D_2 and fourth_moment
    D_4, the moments of |s_0 - s~_0|; upper bounds will do.
    """

    mean_error: float
    cov_error: float
    second_moment: float
    fourth_moment: float

    def __post_init__(self) -> None:
        for name in ("mean_error", "cov_error", "second_moment", "fourth_moment"):
            require_bound(name, getattr(self, name))

    @classmethod
    def point(cls) -> StartLaw:
        """The observed state (Fig. 1, steps 3 and 4)."""
        return cls(0.0, 0.0, 0.0, 0.0)

    @classmethod
    def gaussian(cls, cov: Tensor) -> StartLaw:
        """N(s~_0, Sigma~_0), cov ``[n, n]``."""
        return cls(0.0, 0.0, cov.diagonal().sum().item(), fourth_moment(cov))

    def require_consistent(self, cov: Tensor) -> None:
        """Raise ValueError if no law with these moments has a covariance this near to ``cov``."""
        trace = cov.diagonal().sum().item()
        least = trace - math.sqrt(cov.shape[-1]) * self.cov_error
        if self.second_moment < least * (1 - 1e-12):
            raise ValueError(
                f"second_moment={self.second_moment} is below the trace {least} that the first "
                "covariance implies"
            )
