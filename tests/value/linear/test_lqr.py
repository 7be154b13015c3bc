"""Riccati, Lyapunov and the learner's value agree (exactly, but for rounding)."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.types import Belief
from edtorch.value.linear import moment_value_and_gradient
from edtorch.value.linear.lqr import (
    NotConverged,
    finite_horizon_lqr,
    regulated_value,
    stationary_covariance,
    stationary_lqr,
)
from tests.systems import f64, normal, random_cost

SIZES = [(1, 1), (2, 1), (5, 2), (14, 5)]


def problem(n: int, m: int) -> tuple[Tensor, ...]:
    """F, G, Q, R, mean, covariance, noise; F a little unstable."""
    g = torch.Generator().manual_seed(n)
    F = normal(g, n, n) / n**0.5
    R = random_cost(g, m) + 0.5 * torch.eye(m).double()
    return (
        F,
        normal(g, n, m),
        random_cost(g, n),
        R,
        normal(g, n),
        random_cost(g, n),
        random_cost(g, n),
    )


def rollout_value(
    gains: Tensor,
    F: Tensor,
    G: Tensor,
    Q: Tensor,
    R: Tensor,
    start: Belief,
    W: Tensor,
    gamma: float,
) -> Tensor:
    """V of section 3's definition, by pushing mean and covariance through gains of each step."""
    mean, cov = start.mean, start.cov
    total = torch.zeros((), dtype=torch.float64)
    for k in range(gains.shape[0] + 1):
        theta = gains[k] if k < gains.shape[0] else torch.zeros_like(gains[0])
        C = Q + theta.mT @ R @ theta
        total = total - gamma**k * (mean @ C @ mean + (C * cov).sum())
        A = F + G @ theta
        mean, cov = A @ mean, A @ cov @ A.mT + W
    return total


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_value_of_the_regulator_and_its_zero_gradient(n: int, m: int) -> None:
    F, G, Q, R, mean, cov, W = problem(n, m)
    regulator = finite_horizon_lqr(F, G, Q, R, steps=12, discount=0.95)
    start = Belief(mean, cov)
    gains = regulator.gains.clone().requires_grad_()
    reached = rollout_value(gains, F, G, Q, R, start, W, 0.95)
    expected = regulated_value(regulator, start, W, 0.95)
    assert float((reached.detach() - expected) / expected) == pytest.approx(0, abs=1e-12)
    (gradient,) = torch.autograd.grad(reached, gains)
    assert float(gradient.abs().max()) <= 1e-10 * (1 + abs(float(expected)))


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_no_other_gains_do_better(n: int, m: int) -> None:
    F, G, Q, R, mean, cov, W = problem(n, m)
    regulator = finite_horizon_lqr(F, G, Q, R, steps=6)
    start, g = Belief(mean, cov), torch.Generator().manual_seed(9)
    best = rollout_value(regulator.gains, F, G, Q, R, start, W, 1.0)
    for _ in range(5):
        other = regulator.gains + 0.01 * normal(g, *regulator.gains.shape)
        assert float(rollout_value(other, F, G, Q, R, start, W, 1.0)) < float(best)


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "m"), SIZES)
@pytest.mark.parametrize("discount", [1.0, 0.97])
def test_a_long_horizon_reaches_the_stationary_regulator(n: int, m: int, discount: float) -> None:
    F, G, Q, R, *_ = problem(n, m)
    gain, P = stationary_lqr(F, G, Q, R, discount=discount)
    long = finite_horizon_lqr(F, G, Q, R, steps=600, discount=discount)
    assert torch.allclose(P, long.cost, rtol=1e-10, atol=1e-10 * float(P.abs().max()))
    assert torch.allclose(gain, long.gains[0], rtol=1e-8, atol=1e-10)
    # The equation itself.
    A = F + G @ gain
    again = Q + gain.mT @ R @ gain + discount * A.mT @ P @ A
    assert torch.allclose(again, P, rtol=1e-10, atol=1e-10 * float(P.abs().max()))


def test_a_batch_of_regulators_is_each_ones_own() -> None:
    problems = [problem(3, 2), problem(3, 2)]
    F = torch.stack([problems[0][0], 0.5 * problems[1][0]])
    G = torch.stack([problems[0][1], 2 * problems[1][1]])
    Q, R = problems[0][2], problems[0][3]
    gain, P = stationary_lqr(F, G, Q, R)
    for b in range(2):
        alone = stationary_lqr(F[b], G[b], Q, R)
        assert torch.allclose(gain[b], alone[0], rtol=1e-9, atol=1e-12)
        assert torch.allclose(P[b], alone[1], rtol=1e-9, atol=1e-12)


def test_scalar_riccati_by_hand() -> None:
    # p = q + f^2 p r / (r + p) with f = q = r = 1: p^2 - p - 1 = 0.
    one = f64([[1.0]])
    gain, P = stationary_lqr(one, one, one, one)
    golden = (1 + 5**0.5) / 2
    assert float(P) == pytest.approx(golden, rel=1e-12)
    assert float(gain) == pytest.approx(-golden / (1 + golden), rel=1e-12)


def test_stationary_covariance_solves_its_equation_and_is_what_a_loop_settles_to() -> None:
    g = torch.Generator().manual_seed(4)
    A, W = normal(g, 4, 4), random_cost(g, 4)
    A = 0.9 * A / torch.linalg.eigvals(A).abs().max()
    S = stationary_covariance(A, W)
    assert torch.allclose(S, A @ S @ A.T + W, rtol=1e-10, atol=1e-12)
    assert float(stationary_covariance(f64([[0.5]]), f64([[3.0]]))) == pytest.approx(4, rel=1e-13)
    with pytest.raises(NotConverged, match="not stable"):
        stationary_covariance(f64([[1.01]]), f64([[1.0]]))


def test_what_cannot_be_stabilised_is_refused() -> None:
    F, G = f64([[2.0]]), f64([[0.0]])
    with pytest.raises(NotConverged, match="cannot be stabilised"):
        stationary_lqr(F, G, f64([[1.0]]), f64([[1.0]]))


@pytest.mark.oracle
def test_gradient_ascent_on_the_learners_value_finds_the_regulator() -> None:
    """The value that the learner climbs has its top at the regulator's gain, in the long run."""
    F, G, Q, R, mean, cov, W = problem(2, 1)
    gain, _ = stationary_lqr(F, G, Q, R)
    weights = torch.ones(120, dtype=torch.float64)
    start = Belief(0 * mean.unsqueeze(0), 0 * cov.unsqueeze(0))
    _, gradient = moment_value_and_gradient(
        F[None] - torch.eye(len(F)),
        G[None],
        gain[None],
        start,
        W[None],
        state_cost=Q,
        action_cost=R,
        weights=weights,
    )
    off = gain + 0.1
    _, away = moment_value_and_gradient(
        F[None] - torch.eye(len(F)),
        G[None],
        off[None],
        start,
        W[None],
        state_cost=Q,
        action_cost=R,
        weights=weights,
    )
    # What is left at the top is what the ends of a finite horizon ask for.
    assert float(gradient.norm()) < 0.05 * float(away.norm())
