"""Rules for nu~, the covariance of the next state (Fig. 1, step 2).

Each rule is a frozen dataclass with ``initial`` (its memory, per learner), ``update`` and
``covariance``, pure functions of that memory.  Units are the model's: per second in the derivative
form, per step in the next-state form.  All results are positive semidefinite by construction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from edtorch.linalg import matvec, symmetric_eigen
from edtorch.shapes import Features, Squares
from edtorch.types import Parameters, each_learner


class Noise(Protocol):
    """A rule for nu~."""

    is_constant: ClassVar[bool]
    """Whether nu~ is the same for every state and action.

    Optional: ``dt_per_learner``, that ``unit`` may be ``[B]``; ``needs``, names of what ``update``
    reads in the memory of the fit; ``is_quadratic``, that nu~ is nu (1 + ``stretch`` phi' P phi)
    with ``nu`` and ``P`` its memory, for which ``edtorch.value.linear.ignorance`` has a closed
    form.
    """

    def initial(self, weight: Tensor) -> Parameters:
        """The memory for models of weights ``[*batch, n, k]``."""
        ...

    def update(
        self, memory: Parameters, squared: Squares, phi: Features, fit: Parameters, unit: Tensor
    ) -> Parameters:
        """Move nu~ towards ``squared`` ``[*batch, n, n]``, the residual times itself.

        phi ``[*batch, k]``: the model's features; fit: the memory of the model's fit, before this
        transition; unit: what a rate is multiplied with.
        """
        ...

    def covariance(self, memory: Parameters, phi: Features) -> Tensor:
        """nu~ ``[*batch, n, n]`` at features ``[*batch, k]``."""
        ...


class QuadraticNoise(Noise, Protocol):
    """A rule with ``is_quadratic``."""

    @property
    def stretch(self) -> float:
        """Factor of phi' P phi."""
        ...


def _check_rate(rate: float) -> None:
    if not rate >= 0:
        raise ValueError(f"rate={rate}: expected a number >= 0")


def _share(rate: float, unit: Tensor) -> Tensor:
    """The share of the newest residual in a moving average, at most 1: ``[]`` or ``[B]``."""
    return (rate * unit).clamp(max=1.0)


def _averaged(old: Tensor, new: Tensor, share: Tensor) -> Tensor:
    return torch.lerp(old, new, each_learner(share, new.ndim))


@dataclass(frozen=True)
class ResidualNoise:
    """nu~ <- e e' (Fig. 1, step 2) for a full covariance: the moving average of squared residuals.

    nu~ += rate unit (e e' - nu~), a weighted mean of positive semidefinite matrices.
    """

    rate: float
    is_constant: ClassVar[bool] = True
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_rate(self.rate)

    def initial(self, weight: Tensor) -> Parameters:
        """nu ``[*batch, n, n]``, zero."""
        n = weight.shape[-2]
        return {"nu": weight.new_zeros(*weight.shape[:-2], n, n)}

    def update(
        self, memory: Parameters, squared: Squares, phi: Features, fit: Parameters, unit: Tensor
    ) -> Parameters:
        """One step of the average."""
        return {"nu": _averaged(memory["nu"], squared, _share(self.rate, unit))}

    def covariance(self, memory: Parameters, phi: Features) -> Tensor:
        """nu, wherever the state is."""
        return memory["nu"]


@dataclass(frozen=True)
class LinearNoise:
    """nu~(s, a) = sum_k psi_k V_k, linear in the non-negative features psi = (1, phi_1^2, ...).

    Each V_k is positive semidefinite, and so is the sum.  Fitted by normalised gradient steps on
    the squared difference between nu~ and e e', each followed by the projection of every V_k onto
    the semidefinite matrices (Higham, "Computing a nearest symmetric positive semidefinite matrix",
    1988), so that nothing has to be repaired, or differentiated through, where nu~ is used.
    """

    rate: float
    is_constant: ClassVar[bool] = False
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_rate(self.rate)

    def initial(self, weight: Tensor) -> Parameters:
        """V ``[*batch, 1 + k, n, n]``, zero."""
        *batch, n, k = weight.shape
        return {"V": weight.new_zeros(*batch, 1 + k, n, n)}

    def update(
        self, memory: Parameters, squared: Squares, phi: Features, fit: Parameters, unit: Tensor
    ) -> Parameters:
        """One projected gradient step."""
        psi = self._psi(phi)
        step = _share(self.rate, unit) / psi.square().sum(-1)
        error = squared - self.covariance(memory, phi)
        weight = (step.unsqueeze(-1) * psi).unsqueeze(-1).unsqueeze(-1)
        moved = memory["V"] + weight * error.unsqueeze(-3)
        values, vectors = symmetric_eigen(0.5 * (moved + moved.mT))
        return {"V": (vectors * values.clamp(min=0.0).unsqueeze(-2)) @ vectors.mT}

    def covariance(self, memory: Parameters, phi: Features) -> Tensor:
        """sum_k psi_k V_k."""
        return (self._psi(phi).unsqueeze(-1).unsqueeze(-1) * memory["V"]).sum(-3)

    @staticmethod
    def _psi(phi: Tensor) -> Tensor:
        return torch.cat([torch.ones_like(phi[..., :1]), phi.square()], dim=-1)


@dataclass(frozen=True)
class BayesianNoise:
    """nu~(s, a) = nu (1 + stretch phi' P phi): what the model does not know counts as noise.

    For a model W phi with normal noise nu and the posterior covariance nu P of its weights (a fit
    that keeps ``P``), the prediction of one tick has the covariance nu (1 + phi' P phi) (Bishop,
    "Pattern Recognition and Machine Learning", eq. 3.58).  nu is the moving average of the
    residuals' squares over that factor, which makes it the variance of the noise alone from the
    first tick on.

    stretch: 1 in the next-state form.  In the derivative form the error of the weights does not
    average out within a step of the unroll as the noise does: over Delta seconds made of ticks of
    dt it adds Delta^2 / dt instead of Delta, so that stretch = Delta / dt.  From step to step that
    error is the same, while the transform takes it for independent: nu~ errs on the low side there.
    """

    rate: float
    stretch: float = 1.0
    is_constant: ClassVar[bool] = False
    is_quadratic: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("P",)
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_rate(self.rate)
        if not self.stretch > 0:
            raise ValueError(f"stretch={self.stretch}: expected a number > 0")

    def initial(self, weight: Tensor) -> Parameters:
        """nu ``[*batch, n, n]`` and P ``[*batch, k, k]``, zero."""
        *batch, n, k = weight.shape
        return {"nu": weight.new_zeros(*batch, n, n), "P": weight.new_zeros(*batch, k, k)}

    def update(
        self, memory: Parameters, squared: Squares, phi: Features, fit: Parameters, unit: Tensor
    ) -> Parameters:
        """One step of the average; P is taken from the fit."""
        factor = 1 + self._ignorance(fit["P"], phi)
        nu = _averaged(memory["nu"], squared / factor, _share(self.rate, unit))
        return {"nu": nu, "P": fit["P"]}

    def covariance(self, memory: Parameters, phi: Features) -> Tensor:
        """nu (1 + stretch phi' P phi)."""
        return memory["nu"] * (1 + self.stretch * self._ignorance(memory["P"], phi))

    @staticmethod
    def _ignorance(P: Tensor, phi: Tensor) -> Tensor:
        return (phi * matvec(P, phi)).sum(-1).unsqueeze(-1).unsqueeze(-1)
