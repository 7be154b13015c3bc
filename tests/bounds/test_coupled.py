"""No bound is exceeded on random systems: 66 of them, ten steps, by coupled Monte Carlo."""

from __future__ import annotations

import math

import pytest
import torch

from edtorch.bounds import (
    GAUSSIAN,
    UNIFORM,
    Constants,
    NoiseLaw,
    Path,
    StartLaw,
    bound_errors,
    corrected_covariance_bound,
    corrected_mean_bound,
    corrected_reward_bound,
    definition_weights,
    noise_change,
)
from edtorch.types import Belief
from tests.bounds.coupled import Draw, Step, coupled, gaussian, uniform
from tests.bounds.systems import smooth_system
from tests.systems import random_cost

HORIZON = 10


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


@pytest.mark.oracle
@pytest.mark.parametrize("n, count", [(1, 100_000), (2, 50_000), (5, 25_000)])
@pytest.mark.parametrize("draw, law", [(gaussian, GAUSSIAN), (uniform, UNIFORM)])
def test_no_bound_is_exceeded(n: int, count: int, draw: Draw, law: NoiseLaw) -> None:
    violations = []
    weights = definition_weights(0.95, HORIZON)
    for index in range(11):
        seed = index + (100 if law is UNIFORM else 0)
        # The last three start from a Gaussian; every other system is strongly driven.
        system = smooth_system(n, seed, v0=0.2 if index % 2 else 0.02)
        start, started = None, StartLaw.point()
        if index >= 8:
            cov = 0.05 * random_cost(torch.Generator().manual_seed(seed), n)
            start, started = Belief(system.start, cov), StartLaw.gaussian(cov)
        path, constants = system.path(HORIZON, start), system.constants()
        bounds = bound_errors(path, constants, noise_law=law, weights=weights, start=started)
        steps, value = coupled(system, path, draw, count, weights, seed)
        assert bounds.standing == "certified"
        for t, step in enumerate(steps):
            T1, T2, T3 = one_step(path, t, step, constants)
            following = steps[t + 1] if t < HORIZON else None
            checks = {
                "T1": following is not None and following.mean.exceeds(T1),
                "T2": following is not None and following.cov.exceeds(T2),
                "T3": step.reward.exceeds(T3),
                "mean": step.mean.exceeds(bounds.mean[t]),
                "cov": step.cov.exceeds(bounds.cov[t]),
                "reward": step.reward.exceeds(bounds.reward[t]),
                "second_moment": step.second_moment.exceeds(bounds.second_moment[t]),
                "fourth_moment": step.fourth_moment.exceeds(bounds.fourth_moment[t]),
            }
            violations += [(seed, t, name) for name, broken in checks.items() if broken]
        violations += [(seed, "value")] * value.exceeds(bounds.value)
    assert violations == []
