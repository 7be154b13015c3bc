"""Rules for "f(x) <- y" (Fig. 1, steps 1 and 2): adjust W so that W phi comes closer to y.

Each rule is a frozen dataclass with ``initial`` (its memory, per learner) and ``update``, a pure
function of the weights ``[*batch, n, k]``, that memory, the regressor phi ``[*batch, k]`` and the
target y ``[*batch, n]``.  ``unit`` is what a rate is multiplied with: the tick in seconds for
models of the derivative, 1 for models of the next state.  It is ``[]``, or ``[B]`` for rules of
which ``dt_per_learner`` says that they take one for each learner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from edtorch.linalg import matvec, symmetric_eigen
from edtorch.shapes import Features, States, Weights
from edtorch.types import Parameters, each_learner


@dataclass(frozen=True)
class Fitted:
    """Result of one update: weights, the rule's memory, and y - W phi before the update."""

    weight: Tensor
    memory: Parameters
    residual: Tensor


class Fit(Protocol):
    """A rule for fitting weights that act linearly on features."""

    def initial(self, weight: Weights) -> Parameters:
        """The rule's memory for weights ``[*batch, n, k]``."""
        ...

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """One step towards W phi = y."""
        ...


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return a.unsqueeze(-1) * b.unsqueeze(-2)


def _check_rate(rate: float) -> None:
    if not rate >= 0:
        raise ValueError(f"rate={rate}: expected a number >= 0")


@dataclass(frozen=True)
class AbsoluteError:
    """Gradient of |y - W phi| per component (section 4): W += rate unit sign(y - W phi) phi'.

    Converges to the median, and so shrugs off outliers.  rate: per second or per step.
    """

    rate: float
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_rate(self.rate)

    def initial(self, weight: Weights) -> Parameters:
        """No memory."""
        return {}

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """One subgradient step."""
        residual = y - matvec(weight, phi)
        step = _outer(residual.sign(), self.rate * each_learner(unit, phi.ndim) * phi)
        return Fitted(weight + step, memory, residual)


@dataclass(frozen=True)
class SquaredError:
    """Gradient of 1/2 (y - W phi)^2: W += rate unit (y - W phi) phi'.  Converges to the mean."""

    rate: float
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_rate(self.rate)

    def initial(self, weight: Weights) -> Parameters:
        """No memory."""
        return {}

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """One gradient step."""
        residual = y - matvec(weight, phi)
        return Fitted(
            weight + _outer(residual, self.rate * each_learner(unit, phi.ndim) * phi),
            memory,
            residual,
        )


@dataclass(frozen=True)
class NormalisedSquaredError:
    """Squared error with the step divided by floor + |phi|^2 (normalised least mean squares).

    Stable for rate unit in (0, 2), whatever the size of the features.
    """

    rate: float
    floor: float = 1e-3
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_rate(self.rate)
        if not self.floor > 0:
            raise ValueError(f"floor={self.floor}: expected a number > 0")

    def initial(self, weight: Weights) -> Parameters:
        """No memory."""
        return {}

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """One normalised gradient step."""
        residual = y - matvec(weight, phi)
        size = self.floor + phi.square().sum(-1, keepdim=True)
        return Fitted(
            weight + _outer(residual, self.rate * each_learner(unit, phi.ndim) * phi / size),
            memory,
            residual,
        )


@dataclass(frozen=True)
class RecursiveLeastSquares:
    """Least squares of all data so far, one sample at a time.

    After Ljung, "System Identification", chapter 11.
    P starts at ``prior`` I (the weights' prior covariance over the noise variance); ``forgetting``
    lambda in (0, 1] weighs a sample of k steps ago with lambda^k.  With lambda = 1 the result
    equals ridge regression with the penalty 1 / prior.
    """

    prior: float = 1000.0
    forgetting: float = 1.0
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.prior > 0:
            raise ValueError(f"prior={self.prior}: expected a number > 0")
        if not 0 < self.forgetting <= 1:
            raise ValueError(f"forgetting={self.forgetting}: expected a number in (0, 1]")

    def initial(self, weight: Weights) -> Parameters:
        """P ``[*batch, k, k]``."""
        k = weight.shape[-1]
        eye = torch.eye(k, dtype=weight.dtype, device=weight.device)
        return {"P": (self.prior * eye).expand(*weight.shape[:-2], k, k).clone()}

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """W += (y - W phi) g', P = (P - g phi' P) / lambda, g = P phi / (lambda + phi' P phi)."""
        P = memory["P"]
        residual = y - matvec(weight, phi)
        projected = matvec(P, phi)
        scale = self.forgetting + (phi * projected).sum(-1, keepdim=True)
        gain = projected / scale
        P = (P - _outer(projected, gain)) / self.forgetting
        # Rounding makes P asymmetric, and the asymmetry would grow: it feeds on itself.
        P = 0.5 * (P + P.transpose(-1, -2))
        return Fitted(weight + _outer(residual, gain), {"P": P}, residual)


@dataclass(frozen=True)
class BayesianLeastSquares:
    """Bayesian linear regression whose prior is chosen by its evidence, anew at every sample.

    The weights of each output have the prior N(0, sigma^2 / a I) and the posterior covariance
    sigma^2 P, P = (A + a I)^-1, A = sum phi phi'.  The precision a, shared by the outputs, is the
    one of a grid (``priors`` values of 1 / a from 10^-3 to 10^6) with the greatest marginal
    likelihood, each output's sigma^2 profiled out (MacKay, "Bayesian interpolation", 1992).
    Everything follows from sums over the samples, so that no sample is kept.
    """

    priors: int = 28
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.priors < 1:
            raise ValueError(f"priors={self.priors}: expected at least one")

    def initial(self, weight: Weights) -> Parameters:
        """A ``[*batch, k, k]``, C = sum phi y' ``[*batch, k, n]``, S = sum y^2 ``[*batch, n]``,
        count ``[*batch]``, P ``[*batch, k, k]``."""
        batch, (n, k) = weight.shape[:-2], weight.shape[-2:]
        zeros = weight.new_zeros
        eye = torch.eye(k, dtype=weight.dtype, device=weight.device)
        return {
            "A": zeros(*batch, k, k),
            "C": zeros(*batch, k, n),
            "S": zeros(*batch, n),
            "count": zeros(batch),
            "P": (10.0**6 * eye).expand(*batch, k, k).clone(),
        }

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """Add the sample, choose the prior, solve."""
        residual = y - matvec(weight, phi)
        A, C = memory["A"] + _outer(phi, phi), memory["C"] + _outer(phi, y)
        S, count = memory["S"] + y.square(), memory["count"] + 1
        values, vectors = symmetric_eigen(A)
        values = values.clamp(min=0.0)
        projected = vectors.mT @ C
        # All candidates at once: [*batch, priors, k] and [*batch, priors, n].
        precision = torch.logspace(3, -6, self.priors, dtype=A.dtype, device=A.device)
        shifted = values.unsqueeze(-2) + precision.unsqueeze(-1)
        explained = (1 / shifted) @ projected.square()
        # No output is explained better than to its rounding error.
        left = (S.unsqueeze(-2) - explained).clamp(min=1e-300).maximum(1e-12 * S.unsqueeze(-2))
        outputs, k = C.shape[-1], C.shape[-2]
        evidence = 0.5 * outputs * (k * precision.log() - shifted.log().sum(-1))
        evidence = evidence - 0.5 * count.unsqueeze(-1) * left.log().sum(-1)
        best = evidence.argmax(-1, keepdim=True)
        chosen = torch.take_along_dim(shifted, best.unsqueeze(-1), dim=-2).squeeze(-2)
        scaled = vectors / chosen.unsqueeze(-2)
        memory = {"A": A, "C": C, "S": S, "count": count, "P": scaled @ vectors.mT}
        return Fitted((scaled @ projected).mT, memory, residual)
