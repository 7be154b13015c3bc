"""Theorems 1-4 for one step: counterexamples to the printed forms, and the corrected ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.func import grad, jacrev, vmap

from edtorch.bounds import (
    corrected_covariance_bound,
    corrected_mean_bound,
    corrected_reward_bound,
    noise_change,
    printed_covariance_bound,
    printed_mean_bound,
    printed_reward_bound,
    printed_reward_order,
    printed_value_bound,
    value_bound,
)
from tests.bounds.systems import RADEMACHER, Law, exact_laws, smooth_system
from tests.systems import f64, normal, random_cost


def hessian(function: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """By two reverse sweeps: forward mode loads parts of torch that warn when they are imported."""
    return jacrev(jacrev(function))


def axes_law(n: int, radius: float) -> Law:
    """Uniform on +-radius e_i."""
    states = radius * torch.cat([torch.eye(n), -torch.eye(n)]).double()
    return Law(states, torch.full((2 * n,), 1 / (2 * n), dtype=torch.float64))


def quartic_root(s: Tensor) -> Tensor:
    """sqrt(1 + sum s_i^4) - 1."""
    return torch.sqrt(1 + (s**4).sum(-1)) - 1


@pytest.mark.parametrize(
    "n, radius, error, printed, corrected",
    [(100, 10.0, 99.005, 90.0, 300.0), (400, 20.0, 399.001, 180.0, 1200.0)],
)
def test_theorem_1_as_printed_is_false(
    n: int, radius: float, error: float, printed: float, corrected: float
) -> None:
    # mu has one component that is not 0; s~ = 0 is its mean's true argument, so epsilon = 0, J = 0.
    law = axes_law(n, radius)
    mean, cov = law.moments()
    M = torch.linalg.matrix_norm(cov).item()
    # Symmetric to the last digit on one processor, to 1e-18 on another: a sum of rounded terms.
    assert torch.allclose(mean, torch.zeros(n).double(), atol=1e-12)
    assert torch.allclose(cov, torch.eye(n).double(), atol=1e-12)
    assert M == pytest.approx(math.sqrt(n))
    actual = law.mean(quartic_root(law.states)).item()
    assert actual == pytest.approx(error, abs=1e-3)
    as_printed = printed_mean_bound(mean_error=0.0, M_mu=6.0, M=M)
    assert as_printed == pytest.approx(printed)
    right = corrected_mean_bound(
        jacobian=0.0, mean_error=0.0, curvature=6.0, second_moment=law.distance_moment(mean, 2)
    )
    assert right == pytest.approx(corrected)
    assert as_printed < actual <= right * (1 + 1e-12)


def test_curvature_of_the_counterexample_is_below_six() -> None:
    g = torch.Generator().manual_seed(0)
    points = normal(g, 200, 12) * torch.logspace(-2, 2, 200, dtype=torch.float64).unsqueeze(-1)
    points = torch.cat([points, 30 * torch.ones(1, 12).double()])
    norms = torch.linalg.matrix_norm(vmap(hessian(quartic_root))(points))
    assert 5.5 < norms.max().item() < 6


class TurningValley:
    """f(s) = 1/2 (s . v(ln |s|))^2, v turning from e_1 through to e_n, one axis a stage of width T.

    Its Hessian is v v' and terms of order 1/T; so its norm tends to 1 as T grows.
    """

    def __init__(self, n: int, width: float) -> None:
        self.n, self.width = n, width

    def direction(self, log_radius: Tensor) -> Tensor:
        stage = (log_radius / self.width).clamp(0, self.n - 1)
        whole = stage.detach().floor().clamp(max=self.n - 2)
        x = stage - whole
        angle = math.pi / 2 * (x - torch.sin(2 * math.pi * x) / (2 * math.pi))
        index = torch.arange(self.n)
        here, there = (index == whole).double(), (index == whole + 1).double()
        return torch.cos(angle) * here + torch.sin(angle) * there

    def __call__(self, s: Tensor) -> Tensor:
        return 0.5 * (s @ self.direction(torch.log(torch.linalg.vector_norm(s)))) ** 2

    def curvature(self) -> float:
        """A bound of |D^2 f|_F: |v'| <= pi / T, |v''| <= 2 pi^2 / T^2."""
        slope = math.pi / self.width
        return (1 + slope) ** 2 + (2 + math.sqrt(self.n)) * slope + 2 * slope**2


@pytest.mark.parametrize("n", [3, 10])
def test_curvature_of_the_turning_valley(n: int) -> None:
    valley = TurningValley(n, 30.0)
    g = torch.Generator().manual_seed(n)
    directions = torch.nn.functional.normalize(normal(g, 300, n), dim=-1)
    logs = torch.rand(300, 1, generator=g, dtype=torch.float64) * 30 * (n - 1)
    norms = torch.linalg.matrix_norm(vmap(hessian(valley))(directions * logs.exp()))
    assert 1 < norms.max().item() <= valley.curvature()


def test_theorem_1_as_printed_is_false_from_ten_dimensions_on() -> None:
    # Atoms +-e^{iT} e_{i+1} with weights e^{-2iT} up to a factor: C = c I and E f = c n / 2, so the
    # printed bound c M_mu 3/2 sqrt n is exceeded where M_mu < sqrt n / 3.
    n, T = 10, 12.0
    scales = torch.exp(T * torch.arange(n, dtype=torch.float64))
    weights = scales**-2 / (scales**-2).sum()
    states = torch.cat([torch.diag(scales), -torch.diag(scales)])
    law = Law(states, torch.cat([weights, weights]) / 2)
    _, cov = law.moments()
    c = cov[0, 0].item()
    assert torch.allclose(cov, c * torch.eye(n).double(), rtol=1e-12)
    valley = TurningValley(n, T)
    # Half a unit in the last place of ln |s| turns v by 1e-15 or so, and s is long.
    assert law.mean(torch.stack([valley(s) for s in states])).item() == pytest.approx(c * n / 2)
    wide = TurningValley(n, 450.0)
    M_mu = wide.curvature()
    M = c * math.sqrt(n)
    assert printed_mean_bound(mean_error=0.0, M_mu=M_mu, M=M) < c * n / 2
    right = corrected_mean_bound(jacobian=0.0, mean_error=0.0, curvature=M_mu, second_moment=c * n)
    assert c * n / 2 <= right < 1.06 * c * n / 2


def test_theorem_2_as_printed_is_false_at_small_scale() -> None:
    # nu = 1 + sqrt(1e-8 + s^2) - 1e-4 on X = +-sigma, mu = 0: noise changes by O(sigma), not M^2.
    def nu(s: Tensor) -> Tensor:
        return 1 + torch.sqrt(1e-8 + s**2) - 1e-4

    for sigma, M in ((0.05, 0.05), (0.1, 0.01)):
        law = axes_law(1, sigma)
        error = (law.mean(nu(law.states)) - nu(f64([0.0]))).abs().item()
        printed = printed_covariance_bound(cov_error=0.0, mean_error=0.0, M_mu=0.0, M_nu=1.0, M=M)
        change = noise_change(
            noise_slope=1.0,
            second_moment=law.distance_moment(f64([0.0]), 2),
            noise_gradient=0.0,
            mean_error=0.0,
            noise_curvature=1e4,  # nu'' at 0
        )
        right = corrected_covariance_bound(
            jacobian=0.0,
            cov_error=0.0,
            noise_change=change,
            curvature=0.0,
            pushed_trace=0.0,
            fourth_moment=sigma**4,
        )
        assert printed < error <= right
        if sigma == 0.05:
            assert error == pytest.approx(0.0499, abs=1e-6) and printed == pytest.approx(0.025)
        else:
            assert error == pytest.approx(0.0999, abs=1e-6) and printed == pytest.approx(0.001)


def test_theorem_2_as_printed_lacks_the_square_of_the_curvature() -> None:
    law = Law(f64([[-1.0], [0.0], [1.0]]), f64([0.25, 0.5, 0.25]))
    _, cov = Law(160 * law.states**2, law.weights).moments()
    fourth = law.distance_moment(f64([0.0]), 4)
    printed = printed_covariance_bound(cov_error=0.0, mean_error=0.0, M_mu=320.0, M_nu=0.0, M=1.0)
    right = corrected_covariance_bound(
        jacobian=0.0,
        cov_error=0.0,
        noise_change=0.0,
        curvature=320.0,
        pushed_trace=0.0,
        fourth_moment=fourth,
    )
    assert (cov.item(), printed, right) == pytest.approx((6400, 3200, 12800))
    assert printed < cov.item() <= right


@pytest.mark.parametrize("n", [1, 2, 5])
def test_corrected_theorems_hold_exactly_for_laws_of_few_atoms(n: int) -> None:
    # Any belief (s~, Sigma~), any law: exact sums on the left, exact moments on the right.
    for seed in range(40):
        system = smooth_system(n, seed, v0=0.3)
        g = torch.Generator().manual_seed(seed)
        scale = 10 ** (-2 + 2.5 * torch.rand(1, generator=g, dtype=torch.float64))
        chances = torch.rand(6, generator=g, dtype=torch.float64) ** 3
        law = Law(system.start + scale * normal(g, 6, n), chances / chances.sum())
        mean, cov = law.moments()
        s = mean + 0.5 * scale * normal(g, n) * (seed % 2)
        sigma = cov + 0.3 * scale**2 * random_cost(g, n) * (seed % 3)
        constants = system.constants()
        J = jacrev(system.mu)(s)
        Dnu = jacrev(system.nu)(s).flatten(0, 1)
        D = [law.distance_moment(s, order) for order in range(5)]
        epsilon = torch.linalg.vector_norm(mean - s).item()
        E = torch.linalg.matrix_norm(cov - sigma).item()
        j = torch.linalg.matrix_norm(J, ord=2).item()
        moved_mean, moved_cov = exact_laws(system, RADEMACHER, 1, law)[1].moments()

        T1 = corrected_mean_bound(
            jacobian=j, mean_error=epsilon, curvature=constants.curvature, second_moment=D[2]
        )
        assert torch.linalg.vector_norm(moved_mean - system.mu(s)).item() <= T1 * (1 + 1e-12)

        T2 = corrected_covariance_bound(
            jacobian=j,
            cov_error=E,
            noise_change=noise_change(
                noise_slope=constants.noise_slope,
                second_moment=D[2],
                noise_gradient=torch.linalg.matrix_norm(Dnu, ord=2).item(),
                mean_error=epsilon,
                noise_curvature=constants.noise_curvature,
            ),
            curvature=constants.curvature,
            pushed_trace=(J @ cov @ J.T).trace().item(),
            fourth_moment=D[4],
        )
        first_order = system.nu(s) + J @ sigma @ J.T
        assert torch.linalg.matrix_norm(moved_cov - first_order).item() <= T2 * (1 + 1e-12)

        def r(x: Tensor, reward=system.reward) -> Tensor:
            return reward(x, x)

        gradient, H = grad(r)(s), hessian(r)(s)
        T3 = corrected_reward_bound(
            gradient=torch.linalg.vector_norm(gradient).item(),
            mean_error=epsilon,
            hessian_frobenius=torch.linalg.matrix_norm(H).item(),
            cov_error=E,
            hessian=torch.linalg.matrix_norm(H, ord=2).item(),
            reward_third=constants.reward_third,
            third_moment=D[3],
        )
        assert D[3] <= math.sqrt(D[2] * D[4]) * (1 + 1e-12)
        gap = law.mean(r(law.states)) - r(s) - 0.5 * (H * sigma).sum()
        assert gap.abs().item() <= T3 * (1 + 1e-12)

        # Theorem 3 as printed, where M bounds the moments, gradient and Hessian, is true.
        M = 1.0001 * max(
            *(law.distance_moment(mean, k) for k in (1, 2, 3, 4)),
            torch.linalg.vector_norm(gradient).item(),
            torch.linalg.matrix_norm(H).item(),
        )
        M_r = constants.reward_third
        printed = printed_reward_bound(cov_error=E, mean_error=epsilon, M_r=M_r, M=M)
        order = printed_reward_order(mean_error=epsilon, M=M)
        assert gap.abs().item() < printed + (E + epsilon + M_r) * order
        # Theorem 1 as printed is true up to n = 9.
        M = 1.0001 * max(j, torch.linalg.matrix_norm(cov).item())
        M_mu = system.frobenius_constants()[0]
        printed = printed_mean_bound(mean_error=epsilon, M_mu=M_mu, M=M)
        assert torch.linalg.vector_norm(moved_mean - system.mu(s)).item() < printed


def test_corrected_theorems_are_attained() -> None:
    # mu = s/2 + 3/2 s^2 (curvature 3), nu = 2 + s, r = 5 s + 2 s^2 + s^3 (third derivative 6) on
    # X >= 0 = s~, where every term of (T1) and (T3) has the same sign.
    law = Law(f64([[0.0], [2.0]]), f64([0.5, 0.5]))
    D_2, D_3 = law.distance_moment(f64([0.0]), 2), law.distance_moment(f64([0.0]), 3)
    T1 = corrected_mean_bound(jacobian=0.5, mean_error=1.0, curvature=3.0, second_moment=D_2)
    assert law.mean(law.states / 2 + 1.5 * law.states**2).item() == pytest.approx(T1, rel=1e-14)
    T3 = corrected_reward_bound(
        gradient=5.0,
        mean_error=1.0,
        hessian_frobenius=4.0,
        cov_error=1.0,
        hessian=4.0,
        reward_third=6.0,
        third_moment=D_3,
    )
    s = law.states
    assert law.mean(5 * s + 2 * s**2 + s**3).item() == pytest.approx(T3, rel=1e-14)


def test_theorem_4_and_its_edge_cases() -> None:
    assert printed_value_bound(discount=1.0, steps=9, reward_error=0.5) == 5
    assert printed_value_bound(discount=0.0, steps=9, reward_error=0.5) == 0.5
    assert printed_value_bound(discount=0.7, steps=0, reward_error=0.5) == 0.5
    closed = (1 - 0.9**8) / (1 - 0.9) * 3
    assert printed_value_bound(discount=0.9, steps=7, reward_error=3.0) == pytest.approx(closed)
    near_one = 1 - 1e-15
    assert printed_value_bound(discount=near_one, steps=7, reward_error=1.0) == pytest.approx(8)
    errors = [0.0, 0.1, 0.4]
    tighter = value_bound(discount=0.5, reward_errors=errors)
    assert tighter == pytest.approx(0.15)
    assert tighter <= printed_value_bound(discount=0.5, steps=2, reward_error=max(errors))
    with pytest.raises(ValueError, match="steps=-1"):
        printed_value_bound(discount=0.5, steps=-1, reward_error=1.0)
    with pytest.raises(ValueError, match=r"discount=1\.5"):
        value_bound(discount=1.5, reward_errors=[1.0])
