r"""One step of the error recursion: what moments and errors become.

Theorems 1-3 (corrected) need moments of X - s~_t, which they do not bound themselves.  With a
global Lipschitz constant L the second and fourth moments close:

    D_2+ = min{ tr Sigma+ + sqrt(n) e_Sigma+ + (e_s+)^2,  L^2 D_2 + tr V + ell D_1 },
    D_4+ = L^4 D_4 + L^2 [(4|V|_2 + 2 tr V) D_2 + (4 M_nu + 2 ell) D_3] + q,
    q    = (tr V)^2 + 2 ell tr V D_1 + ell^2 D_2 + (k - 1)(|V|_F + M_nu |delta|)^2 on the average,

with V = nu(s~_t), D_1 = sqrt D_2, D_3 = sqrt(D_2 D_4) and k the kurtosis of the noise.  (Without
L, bounding D_4 would need D_8 a step earlier, and so on.)  Errors of a learned model enter each
step; see ``docs/theory.md`` for the derivations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from edtorch.bounds.constants import Constants, ModelError, NoiseLaw
from edtorch.bounds.path import Path
from edtorch.bounds.theorems import covariance_remainder, mean_remainder, noise_change


class StepErrors(NamedTuple):
    """Bounds at one step: |epsilon|, |E|_F, D_2, D_4."""

    mean: float
    cov: float
    second: float
    fourth: float

    @property
    def first(self) -> float:
        """D_1 <= sqrt D_2."""
        return math.sqrt(self.second)

    @property
    def third(self) -> float:
        """D_3 <= sqrt(D_2 D_4)."""
        return math.sqrt(self.second) * math.sqrt(self.fourth)


class Remainders(NamedTuple):
    """What one step adds: b_s to the error of the mean, b_Sigma to that of the covariance."""

    mean: float
    cov: float


def spectral(matrices: Tensor) -> Tensor:
    """Largest singular value of each matrix ``[..., p, q]``."""
    return torch.linalg.matrix_norm(matrices, ord=2)


@dataclass(frozen=True)
class StepNorms:
    """Norms along a path, one number for each move or (the last three) each belief."""

    jacobian: list[float]
    gram: list[float]
    pushed_trace: list[float]
    noise_trace: list[float]
    noise_frobenius: list[float]
    noise_spectral: list[float]
    noise_gradient: list[float]
    cov_trace: list[float]
    reward_gradient: list[float]
    hessian: list[float]
    hessian_frobenius: list[float]

    @classmethod
    def of(cls, path: Path) -> StepNorms:
        """Of each step of ``path``."""
        J, cov = path.jacobian, path.cov
        pushed = J @ cov[:-1] @ J.mT
        # nu's derivative as a map from the state to matrices under the Frobenius norm.
        gradient = path.noise_jacobian.flatten(1, 2)

        def trace(matrices: Tensor) -> list[float]:
            return matrices.diagonal(dim1=-2, dim2=-1).sum(-1).tolist()

        return cls(
            jacobian=spectral(J).tolist(),
            gram=torch.linalg.matrix_norm(J.mT @ J).tolist(),
            pushed_trace=trace(pushed),
            noise_trace=trace(path.noise),
            noise_frobenius=torch.linalg.matrix_norm(path.noise).tolist(),
            noise_spectral=spectral(path.noise).tolist(),
            noise_gradient=spectral(gradient).tolist(),
            cov_trace=trace(cov),
            reward_gradient=torch.linalg.vector_norm(path.reward_gradient, dim=-1).tolist(),
            hessian=spectral(path.reward_hessian).tolist(),
            hessian_frobenius=torch.linalg.matrix_norm(path.reward_hessian).tolist(),
        )


def known(bound: float) -> float:
    """``bound``, or infinity where an overflow (0 times infinity) left NaN."""
    return math.inf if math.isnan(bound) else bound


@dataclass(frozen=True)
class StepRule:
    """The recursion's constants for a state of n components, and its norms along the path."""

    n: int
    norms: StepNorms
    noise_law: NoiseLaw
    model_error: ModelError

    def remainders(self, t: int, errors: StepErrors, constants: Constants) -> Remainders:
        """b_s and b_Sigma of the move from step t."""
        eta = self.model_error.mean
        norms, D_2, L = self.norms, errors.second, constants.lipschitz
        change = noise_change(
            noise_slope=constants.noise_slope,
            second_moment=D_2,
            noise_gradient=norms.noise_gradient[t],
            mean_error=errors.mean,
            noise_curvature=constants.noise_curvature,
        )
        pushed = min(
            norms.pushed_trace[t] + norms.gram[t] * errors.cov,
            norms.jacobian[t] * norms.jacobian[t] * D_2,
        )
        cov = covariance_remainder(
            noise_change=change,
            curvature=constants.curvature,
            pushed_trace=pushed,
            fourth_moment=errors.fourth,
        )
        mean = mean_remainder(curvature=constants.curvature, second_moment=D_2) + eta
        # cov(mu^ + d) with |d| <= eta; tr cov mu^(X) <= L^2 D_2.
        cov += self.model_error.cov + 2 * eta * L * errors.first + eta * eta
        return Remainders(known(mean), known(cov))

    def second_moment(self, t: int, errors: StepErrors, constants: Constants) -> float:
        """D_2 of step t + 1 from that of step t: E|mu(X) - s~+|^2 + E tr nu(X)."""
        drift = constants.lipschitz * errors.first + self.model_error.mean
        noise = self.noise_trace(t) + constants.trace_slope(self.n) * errors.first
        return known(drift * drift + noise)

    def noise_trace(self, t: int) -> float:
        """tr nu at s~_t, of the true noise."""
        return self.norms.noise_trace[t] + math.sqrt(self.n) * self.model_error.cov

    def fourth_moment(self, t: int, errors: StepErrors, constants: Constants) -> float:
        """D_4 of step t + 1: E|a + w|^4 expanded, a = mu(X) - s~+ and w the noise."""
        L, eta, eta_nu = constants.lipschitz, self.model_error.mean, self.model_error.cov
        ell, slope = constants.trace_slope(self.n), constants.noise_slope
        D_1, D_2, D_3 = errors.first, errors.second, errors.third
        trace = self.noise_trace(t)
        frobenius = self.norms.noise_frobenius[t] + eta_nu
        # E|a|^4 by Minkowski, as |a| <= L |delta| + eta.
        drift = L * math.sqrt(math.sqrt(errors.fourth)) + eta
        drift_fourth = drift * drift * drift * drift
        # 4 E(a'w)^2 + 2 E|a|^2|w|^2 <= E[(level + rise |delta|) |a|^2].
        level = 4 * (self.norms.noise_spectral[t] + eta_nu) + 2 * trace
        rise = 4 * slope + 2 * ell
        mixed = level * (L * L * D_2 + 2 * L * eta * D_1 + eta * eta)
        mixed += rise * (L * L * D_3 + 2 * L * eta * D_2 + eta * eta * D_1)
        # 4 E(a'w)|w|^2, zero for a symmetric law.
        skew = 4 * (L * D_1 + eta) * self.noise_law.third
        # E|w|^4 by the noise law.
        noise = trace * trace + 2 * ell * trace * D_1 + ell * ell * D_2
        spread = frobenius * frobenius + 2 * frobenius * slope * D_1 + slope * slope * D_2
        return known(drift_fourth + mixed + skew + noise + (self.noise_law.kurtosis - 1) * spread)
