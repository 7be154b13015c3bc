"""Every transform against known answers: where it is exact, and of which order it is elsewhere."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.transform import (
    ConstantNoise,
    Cubature,
    FirstOrder,
    GaussHermite,
    SecondOrder,
    Transform,
)
from edtorch.types import Belief
from tests.systems import f64, normal, random_cost
from tests.transforms import transforms


def linear(matrix: Tensor) -> StateFunction:
    return lambda s: s @ matrix.mT


@pytest.mark.parametrize("transform", transforms(3))
def test_linear_loops_with_constant_noise_are_exact(transform: Transform) -> None:
    g = torch.Generator().manual_seed(0)
    F, W, S, mean = 0.6 * normal(g, 3, 3), random_cost(g, 3), random_cost(g, 3), normal(g, 3)
    belief, steps = Belief(mean, S), 9
    for _ in range(steps):
        belief = transform.move(belief, linear(F), ConstantNoise(W))
    powers = [torch.linalg.matrix_power(F, j) for j in range(steps + 1)]
    noise = torch.stack([P @ W @ P.T for P in powers[:-1]]).sum(0)
    assert torch.allclose(belief.mean, powers[-1] @ mean, rtol=1e-12, atol=1e-14)
    assert torch.allclose(belief.cov, powers[-1] @ S @ powers[-1].T + noise, rtol=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("transform", transforms(2))
def test_the_jitter_of_the_square_root_does_not_accumulate(transform: Transform) -> None:
    # A rotation forgets nothing, the noise is small and singular, and the start is a point.
    c, s = math.cos(0.3), math.sin(0.3)
    F, W = f64([[c, -s], [s, c]]), f64([[1e-9, 0.0], [0.0, 0.0]])
    belief = Belief(f64([1.0, 2.0]), torch.zeros(2, 2).double())
    cov = torch.zeros(2, 2).double()
    for _ in range(300):
        belief = transform.move(belief, linear(F), ConstantNoise(W))
        cov = F @ cov @ F.T + W
    assert float((belief.cov - cov).norm() / cov.norm()) < 1e-9


@pytest.mark.oracle
@pytest.mark.parametrize("transform", transforms(2))
def test_noise_linear_in_the_state_is_exact(transform: Transform) -> None:
    # nu(s) = N0 + s_1 N1 stays positive definite: |s_1| < 4 over these steps, the noise is bounded.
    g = torch.Generator().manual_seed(3)
    F, N0 = f64([[0.5, 0.2], [-0.3, 0.6]]), f64([[0.3, 0.1], [0.1, 0.2]])
    N1 = f64([[0.05, 0.0], [0.0, 0.03]])

    def noise(s: Tensor) -> Tensor:
        return N0 + s[..., :1, None] * N1

    count, start = 200_000, f64([1.0, -0.5])
    x, belief = start.expand(count, 2), Belief(start, torch.zeros(2, 2).double())
    for _ in range(3):
        z = (2 * torch.rand(count, 2, generator=g, dtype=torch.float64) - 1) * 3**0.5
        root = torch.linalg.cholesky(noise(x))
        x = x @ F.T + (root @ z.unsqueeze(-1)).squeeze(-1)
        exact = noise(belief.mean) + F @ belief.cov @ F.T
        belief = transform.move(belief, linear(F), noise)
        assert torch.allclose(belief.cov, exact, rtol=1e-9)
    assert float(x[:, 0].abs().max()) < 4
    away = x - belief.mean
    z_mean = away.mean(0) / (away.std(0) / count**0.5)
    products = away.unsqueeze(-1) * away.unsqueeze(-2)
    z_cov = (products.mean(0) - belief.cov) / (products.std(0) / count**0.5)
    assert float(z_mean.abs().max()) < 4 and float(z_cov.abs().max()) < 4


def quadratic_loop() -> tuple[StateFunction, Tensor, Tensor]:
    """mu(s) = J s + 1/2 H[s, s], with J ``[n, n]`` and H ``[n, n, n]``, symmetric in the last."""
    g = torch.Generator().manual_seed(4)
    J, H = normal(g, 3, 3), normal(g, 3, 3, 3)
    H = H + H.mT

    def loop(s: Tensor) -> Tensor:
        return s @ J.T + 0.5 * torch.einsum("ijk,...j,...k->...i", H, s, s)

    return loop, J, H


def test_second_order_mean_is_exact_for_quadratic_loops_under_any_law() -> None:
    g = torch.Generator().manual_seed(5)
    loop, _, H = quadratic_loop()
    atoms, weight = normal(g, 6, 3), torch.rand(6, generator=g, dtype=torch.float64)
    weight = weight / weight.sum()
    mean = weight @ atoms
    away = atoms - mean
    belief = Belief(mean, (weight.unsqueeze(-1) * away).T @ away)
    none = ConstantNoise(torch.zeros(3, 3).double())
    exact = weight @ loop(atoms)
    assert torch.allclose(SecondOrder().move(belief, loop, none).mean, exact, rtol=1e-12)
    error = exact - FirstOrder().move(belief, loop, none).mean
    assert torch.allclose(error, 0.5 * torch.einsum("ijk,jk->i", H, belief.cov), rtol=1e-11)


def test_second_order_covariance_is_exact_for_quadratic_loops_and_gaussians() -> None:
    g = torch.Generator().manual_seed(6)
    loop, J, H = quadratic_loop()
    mean, C, W = normal(g, 3), random_cost(g, 3), random_cost(g, 3)
    moved = SecondOrder().move(Belief(mean, C), loop, ConstantNoise(W))
    slope = J + H @ mean
    HC = H @ C
    formula = W + slope @ C @ slope.T + 0.5 * torch.einsum("iab,jba->ij", HC, HC)
    assert torch.allclose(moved.cov, formula, rtol=1e-12)
    # The same by a quadrature that integrates quartics exactly.
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    z = f64(list(itertools.product(nodes, repeat=3)))
    w = f64(list(itertools.product(weights / weights.sum(), repeat=3))).prod(-1)
    y = loop(mean + z @ torch.linalg.cholesky(C).T)
    away = y - w @ y
    assert torch.allclose(moved.cov, W + (w.unsqueeze(-1) * away).T @ away, rtol=1e-12)
    assert torch.allclose(moved.mean, w @ y, rtol=1e-12)


def sine(transform: Transform, v: float, m: float = 0.8) -> Belief:
    none = ConstantNoise(torch.zeros(1, 1).double())
    return transform.move(Belief(f64([m]), f64([[v]])), torch.sin, none)


def sine_mean_error(transform: Transform, v: float, m: float = 0.8) -> float:
    return abs(float(sine(transform, v, m).mean) - math.exp(-v / 2) * math.sin(m))


@pytest.mark.parametrize(
    ("transform", "order"),
    [(FirstOrder(), 2), (SecondOrder(), 4), (Cubature(), 4), (GaussHermite(3), 6)],
    ids=["first", "second", "cubature", "gauss_hermite"],
)
def test_order_of_the_mean(transform: Transform, order: int) -> None:
    coarse, fine = sine_mean_error(transform, 0.04), sine_mean_error(transform, 0.01)
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.1)


def test_gauss_hermite_matches_the_moments_of_a_sine() -> None:
    m, v = 0.8, 0.3
    moved = sine(GaussHermite(20), v, m)
    assert float(moved.mean) == pytest.approx(math.exp(-v / 2) * math.sin(m), rel=1e-9)
    variance = (1 - math.exp(-2 * v) * math.cos(2 * m)) / 2 - math.exp(-v) * math.sin(m) ** 2
    assert float(moved.cov) == pytest.approx(variance, rel=1e-9)


def test_noise_is_averaged_to_second_order() -> None:
    # E sin^2 s = (1 - e^{-2v} cos 2m) / 2 for s ~ N(m, v).
    def noise(s: Tensor) -> Tensor:
        return s.sin().square().unsqueeze(-1)

    m, orders = 0.4, {"first": 2, "second": 4, "cubature": 4}
    for name, transform in zip(orders, [FirstOrder(), SecondOrder(), Cubature()], strict=True):
        errors = []
        for v in (0.01, 0.0025):
            moved = transform.move(Belief(f64([m]), f64([[v]])), torch.zeros_like, noise)
            exact = (1 - math.exp(-2 * v) * math.cos(2 * m)) / 2
            errors.append(abs(float(moved.cov) - exact))
        assert math.log2(errors[0] / errors[1]) == pytest.approx(orders[name], abs=0.1)


@pytest.mark.parametrize("transform", transforms(3))
def test_expected_quadratic_reward_is_exact_under_any_law(transform: Transform) -> None:
    g = torch.Generator().manual_seed(7)
    Q, R, K = random_cost(g, 3), random_cost(g, 2), normal(g, 2, 3)

    def reward(state: Tensor, action: Tensor) -> Tensor:
        return -(state @ Q * state).sum(-1) - (action @ R * action).sum(-1) + state[..., 0]

    atoms, weight = normal(g, 7, 3), torch.rand(7, generator=g, dtype=torch.float64)
    weight = weight / weight.sum()
    mean = weight @ atoms
    away = atoms - mean
    belief = Belief(mean, (weight.unsqueeze(-1) * away).T @ away)
    exact = weight @ reward(atoms, atoms @ K.T)
    assert float(transform.reward(reward, belief, linear(K))) == pytest.approx(
        float(exact), rel=1e-9
    )
