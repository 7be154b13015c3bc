"""The path that the bounds are computed along."""

from __future__ import annotations

import pytest
import torch

from edtorch.bounds import (
    first_order_path,
)
from edtorch.rewards import QuadraticReward
from edtorch.types import Belief
from tests.bounds.systems import (
    smooth_system,
)
from tests.systems import f64


def test_the_path_is_the_first_order_unroll_with_its_derivatives() -> None:
    # Eq. 2 and Fig. 1 step 6c, with the Jacobian written out.
    system, steps = smooth_system(2, 0), 5
    start = Belief(system.start, 0.1 * torch.eye(2, dtype=torch.float64))
    path = system.path(steps, start)
    mean, cov = start.mean, start.cov
    for t in range(steps + 1):
        assert torch.allclose(path.mean[t], mean, rtol=1e-13)
        assert torch.allclose(path.cov[t], cov, rtol=1e-12)
        waves = torch.sin(system.f @ mean + system.g)
        gradient = -2 * system.Q @ mean + system.q
        gradient = gradient + 0.2 * torch.cos(system.f @ mean + system.g) @ system.f
        H = -2 * system.Q - 0.2 * system.f.T @ torch.diag(waves) @ system.f
        assert torch.allclose(path.reward_gradient[t], gradient, rtol=1e-12)
        assert torch.allclose(path.reward_hessian[t], H, rtol=1e-12)
        gain = system.reward(mean, mean) + 0.5 * torch.trace(H @ cov)
        assert path.expected_reward[t].item() == pytest.approx(gain.item(), rel=1e-12)
        slope = 1 - torch.tanh(system.W @ mean + system.b) ** 2
        J = system.A + system.B @ torch.diag(slope) @ system.W
        mean, cov = system.mu(mean), system.nu(mean) + J @ cov @ J.T
    # Derivatives against central differences.
    s, h = path.mean[2], 1e-6
    for k in range(2):
        step = h * torch.eye(2).double()[k]
        mu = (system.mu(s + step) - system.mu(s - step)) / (2 * h)
        nu = (system.nu(s + step) - system.nu(s - step)) / (2 * h)
        assert torch.allclose(path.jacobian[2][:, k], mu, rtol=1e-6, atol=1e-9)
        assert torch.allclose(path.noise_jacobian[2][..., k], nu, rtol=1e-5, atol=1e-9)


def test_reward_derivatives_go_through_the_policy() -> None:
    # r = -(s^2 + a^2) with a = s^2: r_pi = -s^2 - s^4, gradient -2 s - 4 s^3, Hessian -2 - 12 s^2.
    path = first_order_path(
        Belief(f64([2.0]), f64([[0.5]])),
        lambda s: 0.5 * s,
        lambda s: torch.zeros((*s.shape, 1), dtype=torch.float64),
        torch.square,
        reward=QuadraticReward(f64([[1.0]]), f64([[1.0]])),
        steps=1,
    )
    assert path.reward_gradient[:, 0].tolist() == pytest.approx([-36, -6])
    assert path.reward_hessian[:, 0, 0].tolist() == pytest.approx([-50, -14])
    assert path.expected_reward.tolist() == pytest.approx([-20 - 12.5, -2 - 7 * 0.125])
