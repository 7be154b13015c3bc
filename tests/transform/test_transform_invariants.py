"""What holds for every transform on any smooth system: batches, gradients, symmetry, positivity."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from edtorch.transform import (
    ConstantNoise,
    Cubature,
    FirstOrder,
    SecondOrder,
    Transform,
    point_belief,
)
from edtorch.transform.points import factor
from edtorch.types import Belief, Trajectory
from edtorch.value.unroll import Horizon, propagate
from tests.smooth_systems import SmoothSystem, random_system
from tests.systems import f64, normal, random_cost
from tests.transforms import transforms

HORIZON = Horizon(5, 1.0, 0.9, 1.0)


def roll(
    system: SmoothSystem, transform: Transform, start: Belief, horizon: Horizon = HORIZON
) -> Trajectory:
    return propagate(
        start,
        system.closed_loop,
        system.policy,
        reward=system.reward,
        transform=transform,
        noise=system.noise,
        horizon=horizon,
    )


def value_of(system: SmoothSystem, transform: Transform, W: Tensor, start: Belief) -> Tensor:
    return roll(replace(system, W=W), transform, start).value


@pytest.mark.parametrize("transform", transforms(3, mean_only=True))
def test_a_batch_is_its_rows(transform: Transform) -> None:
    system = random_system(3, 0)
    g = torch.Generator().manual_seed(0)
    mean = normal(g, 2, 4, 3)
    cov = torch.stack([0.1 * random_cost(g, 3) for _ in range(8)]).reshape(2, 4, 3, 3)
    together = roll(system, transform, Belief(mean, cov))
    alone = roll(system, transform, Belief(mean[1, 2], cov[1, 2]))
    assert together.cov.shape == (6, 2, 4, 3, 3) and together.first_floored.shape == (2, 4)
    assert torch.allclose(together.mean[:, 1, 2], alone.mean, rtol=1e-12, atol=1e-14)
    assert torch.allclose(together.cov[:, 1, 2], alone.cov, rtol=1e-12, atol=1e-14)
    assert torch.allclose(together.value[1, 2], alone.value, rtol=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("transform", transforms(3, mean_only=True))
def test_vmap_of_the_gradient_is_the_gradient_of_each(transform: Transform) -> None:
    system = random_system(3, 1)
    starts = normal(torch.Generator().manual_seed(1), 3, 3)

    def gradient(s: Tensor) -> Tensor:
        def value(W: Tensor) -> Tensor:
            return value_of(system, transform, W, point_belief(s))

        return torch.func.grad(value)(system.W)

    together = torch.func.vmap(gradient)(starts)
    for k in range(3):
        assert torch.allclose(together[k], gradient(starts[k]), rtol=1e-9, atol=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("transform", transforms(2, mean_only=True))
@pytest.mark.parametrize("spread", [0.0, 0.05])
def test_gradient_of_the_value_from_a_point_and_from_a_belief(
    transform: Transform, spread: float
) -> None:
    system = random_system(2, 2)
    start = Belief(system.start, spread * torch.eye(2).double())
    W = system.W.clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda w: value_of(system, transform, w, start), (W,), eps=1e-6, atol=1e-6, rtol=1e-6
    )


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_cubature_differentiates_where_the_covariance_is_singular(rank: int) -> None:
    """d mean' / d Sigma = 1/2 H and d cov' = J dSigma J', for mu quadratic, also at Sigma = 0."""
    g = torch.Generator().manual_seed(rank)
    J, H = normal(g, 2, 2), normal(g, 2, 2, 2)
    H = H + H.mT
    root = normal(g, 2, 2)[:, :rank]
    mean, cov = torch.zeros(2).double(), root @ root.T
    D = random_cost(g, 2)

    def loop(s: Tensor) -> Tensor:
        return s @ J.T + 0.5 * torch.einsum("ijk,...j,...k->...i", H, s, s)

    def moved(t: Tensor) -> tuple[Tensor, Tensor]:
        # From Sigma into the cone: at its boundary there are no other directions.
        after = Cubature().move(
            Belief(mean, cov + t * D), loop, ConstantNoise(torch.zeros(2, 2).double())
        )
        return after.mean, after.cov

    slope = torch.func.jacrev(moved)(torch.zeros(()).double())
    assert torch.allclose(slope[0], 0.5 * torch.einsum("ijk,jk->i", H, D), rtol=1e-6, atol=1e-8)
    if rank == 0:
        assert torch.allclose(slope[1], J @ D @ J.T, rtol=1e-6, atol=1e-8)


@pytest.mark.oracle
def test_cubature_gradient_in_single_precision() -> None:
    system = random_system(3, 3)
    parts = {name: part.float() for name, part in vars(system).items() if isinstance(part, Tensor)}
    single = replace(system, **parts)
    exact = torch.func.grad(lambda W: value_of(system, Cubature(), W, point_belief(system.start)))(
        system.W
    )
    rough = torch.func.grad(lambda W: value_of(single, Cubature(), W, point_belief(single.start)))(
        single.W
    )
    assert rough.dtype == torch.float32
    assert float((rough - exact).norm() / exact.norm()) < 1e-3


@pytest.mark.oracle
@pytest.mark.parametrize("n", [1, 2, 5])
def test_covariance_stays_symmetric_and_positive(n: int) -> None:
    for seed in range(3):
        system = random_system(n, seed, nl=0.9, v0=0.2)
        for transform in (FirstOrder(), SecondOrder(), Cubature()):
            path = roll(system, transform, point_belief(system.start), Horizon(20, 1.0, 1.0, 1.0))
            values = torch.linalg.eigvalsh(path.cov)
            assert torch.equal(path.cov, path.cov.mT)
            assert bool((values[:, 0] >= -1e-12 * values[:, -1]).all())


def test_figure_1_in_plain_numbers() -> None:
    """mu_pi(s) = .9 s + .2 cos s, nu(s) = .1 + .05 sin s, r(s) = -s^2 + .1 s^3 by hand."""
    s, variance, value, gamma = 0.7, 0.0, 0.0, 0.9
    for tau in range(1, 6):
        slope = 0.9 - 0.2 * math.sin(s)
        variance = 0.1 + 0.05 * math.sin(s) + slope**2 * variance
        s = 0.9 * s + 0.2 * math.cos(s)
        value += gamma ** (tau - 1) * (0.5 * (-2 + 0.6 * s) * variance - s**2 + 0.1 * s**3)
    path = propagate(
        point_belief(f64([0.7])),
        lambda x: 0.9 * x + 0.2 * x.cos(),
        torch.zeros_like,
        reward=lambda state, action: (-(state**2) + 0.1 * state**3)[..., 0],
        transform=FirstOrder(),
        noise=lambda x: (0.1 + 0.05 * x.sin()).unsqueeze(-1),
        horizon=Horizon(5, 1.0, gamma, 1.0),
    )
    assert float(path.mean[-1]) == pytest.approx(s, rel=1e-13)
    assert float(path.cov[-1]) == pytest.approx(variance, rel=1e-13)
    assert float(path.value) == pytest.approx(value, rel=1e-13)


def moved_system(system: SmoothSystem, U: Tensor, c: Tensor) -> tuple:
    """The same system in coordinates x = U s + c: closed loop, reward and noise."""

    def back(x: Tensor) -> Tensor:
        return (x - c) @ U

    def closed_loop(x: Tensor) -> Tensor:
        return system.closed_loop(back(x)) @ U.T + c

    def reward(x: Tensor, a: Tensor) -> Tensor:
        return system.state_reward(back(x))

    def noise(x: Tensor) -> Tensor:
        return U @ system.noise(back(x)) @ U.T

    return closed_loop, reward, noise


@pytest.mark.parametrize("transform", transforms(3, mean_only=True, monte_carlo=False))
def test_coordinates_do_not_matter(transform: Transform) -> None:
    """Translations and reflections of axes; rotations too where no points stand along axes."""
    system = random_system(3, 4)
    g = torch.Generator().manual_seed(8)
    rotation = torch.linalg.qr(normal(g, 3, 3))[0]
    reflection = torch.diag(f64([1.0, -1.0, -1.0]))
    turns = transform.differentiates_reward or not transform.propagates_covariance
    start = Belief(system.start, 0.1 * random_cost(g, 3))
    plain = roll(system, transform, start)
    for U in (reflection, rotation) if turns else (reflection,):
        c = normal(g, 3)
        closed_loop, reward, noise = moved_system(system, U, c)
        other = propagate(
            Belief(U @ start.mean + c, U @ start.cov @ U.T),
            closed_loop,
            system.policy,
            reward=reward,
            transform=transform,
            noise=noise,
            horizon=HORIZON,
        )
        assert torch.allclose(other.mean, plain.mean @ U.T + c, rtol=1e-11, atol=1e-12)
        assert torch.allclose(other.cov, U @ plain.cov @ U.T, rtol=1e-11, atol=1e-12)
        assert torch.allclose(other.value, plain.value, rtol=1e-11)


def test_the_square_root_of_what_is_no_covariance_is_no_number() -> None:
    bad = torch.diag(f64([1.0, -0.1]))
    rows = factor(torch.stack([bad, torch.eye(2).double()]))
    assert bool(rows[0].isnan().all()) and torch.allclose(rows[1], torch.eye(2).double())
    assert bool(factor(torch.full((2, 2), torch.nan).double()).isnan().all())
