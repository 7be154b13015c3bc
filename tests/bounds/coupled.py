r"""Errors of the transform by coupled Monte Carlo.

The same z drives the true chain and x+ = mu(s~) + J (x - s~) + sqrt(nu(s~)) z, whose mean and
covariance are exactly s~ and Sigma~.  The errors are expectations of differences between the two,
which are small where the errors are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.bounds import (
    Constants,
    Path,
    corrected_covariance_bound,
    corrected_mean_bound,
    corrected_reward_bound,
    noise_change,
)
from tests.bounds.systems import SmoothSystem

Draw = Callable[[torch.Generator, int, int], Tensor]
"""N draws of n independent components of mean 0 and variance 1."""


def gaussian(g: torch.Generator, count: int, n: int) -> Tensor:
    return torch.randn(count, n, generator=g, dtype=torch.float64)


def uniform(g: torch.Generator, count: int, n: int) -> Tensor:
    return math.sqrt(12) * (torch.rand(count, n, generator=g, dtype=torch.float64) - 0.5)


@dataclass(frozen=True)
class Estimate:
    """A norm and the standard error of what it is the norm of."""

    size: float
    se: float

    @classmethod
    def of(cls, samples: Tensor) -> Estimate:
        """Of the mean of ``[N, ...]``."""
        flat = samples.flatten(1) if samples.ndim > 1 else samples.unsqueeze(-1)
        se = (flat.var(0).sum() / len(flat)).sqrt().item()
        return cls(torch.linalg.vector_norm(flat.mean(0)).item(), se)

    def exceeds(self, bound: float) -> bool:
        """Whether the estimate lies above the bound by more than four standard errors."""
        return self.size - 4 * self.se > bound + 1e-12


@dataclass(frozen=True)
class Step:
    """Estimates at one step; cov_matrix ``[n, n]`` is the estimated true covariance."""

    mean: Estimate
    cov: Estimate
    reward: Estimate
    second_moment: Estimate
    fourth_moment: Estimate
    cov_matrix: Tensor


def squares(x: Tensor) -> Tensor:
    """x x' for each row ``[N, n]``."""
    return x.unsqueeze(-1) * x.unsqueeze(-2)


def coupled(
    system: SmoothSystem, path: Path, draw: Draw, count: int, weights: list[float], seed: int
) -> tuple[list[Step], Estimate]:
    """Estimates of every step's errors and of the value's; the start is N(s~_0, Sigma~_0)."""
    g = torch.Generator().manual_seed(seed)
    lowest = torch.linalg.eigh(path.cov[0])
    root = lowest.eigenvectors * lowest.eigenvalues.clamp(min=0).sqrt()
    linear = gaussian(g, count, system.n) @ root.T
    X = path.mean[0] + linear
    steps, value = [], torch.zeros(count, dtype=torch.float64)
    for t in range(path.steps + 1):
        delta = X - path.mean[t]
        quadratic = linear @ path.reward_gradient[t]
        quadratic = quadratic + 0.5 * (linear @ path.reward_hessian[t] * linear).sum(-1)
        at_mean = path.expected_reward[t] - 0.5 * (path.reward_hessian[t] * path.cov[t]).sum()
        gain = system.reward(X, X) - at_mean - quadratic
        value += weights[t] * gain
        offset = (delta - linear).mean(0)
        square = (delta * delta).sum(-1)
        second = squares(delta - offset) - squares(linear)
        steps.append(
            Step(
                mean=Estimate.of(delta - linear),
                cov=Estimate.of(second),
                reward=Estimate.of(gain),
                second_moment=Estimate.of(square),
                fourth_moment=Estimate.of(square * square),
                cov_matrix=path.cov[t] + second.mean(0),
            )
        )
        if t < path.steps:
            z = draw(g, count, system.n)
            linear = linear @ path.jacobian[t].T + system.shake(path.mean[t], z)
            X = system.mu(X) + system.shake(X, z)
    return steps, Estimate.of(value)


def one_step(path: Path, t: int, now: Step, constants: Constants) -> tuple[float, float, float]:
    """(T1), (T2) and (T3) from the moments of P_t that Monte Carlo found."""
    J, H = path.jacobian[min(t, path.steps - 1)], path.reward_hessian[t]
    D_2, D_4 = now.second_moment.size, now.fourth_moment.size
    j = torch.linalg.matrix_norm(J, ord=2).item()
    gradient = path.noise_jacobian[min(t, path.steps - 1)].flatten(0, 1)
    change = noise_change(
        noise_slope=constants.noise_slope,
        second_moment=D_2,
        noise_gradient=torch.linalg.matrix_norm(gradient, ord=2).item(),
        mean_error=now.mean.size,
        noise_curvature=constants.noise_curvature,
    )
    return (
        corrected_mean_bound(
            jacobian=j,
            mean_error=now.mean.size,
            curvature=constants.curvature,
            second_moment=D_2,
        ),
        corrected_covariance_bound(
            jacobian=j,
            cov_error=now.cov.size,
            noise_change=change,
            curvature=constants.curvature,
            pushed_trace=(J @ now.cov_matrix @ J.T).trace().item(),
            fourth_moment=D_4,
        ),
        corrected_reward_bound(
            gradient=torch.linalg.vector_norm(path.reward_gradient[t]).item(),
            mean_error=now.mean.size,
            hessian_frobenius=torch.linalg.matrix_norm(H).item(),
            cov_error=now.cov.size,
            hessian=torch.linalg.matrix_norm(H, ord=2).item(),
            reward_third=constants.reward_third,
            third_moment=math.sqrt(D_2 * D_4),
        ),
    )
