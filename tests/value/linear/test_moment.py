"""Mean and covariance together: against the generic path, finite differences and Monte Carlo."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Affine, Identity
from edtorch.model.noise import ResidualNoise
from edtorch.transform import Cubature, FirstOrder, Transform
from edtorch.types import Belief
from edtorch.value.choose import choose_path
from edtorch.value.linear import LinearMoment, mean_value_and_gradient, moment_value_and_gradient
from edtorch.value.linear.moment import second_moments
from tests.systems import (
    Features,
    LinearCase,
    linear_case,
    normal,
    random_cost,
    same_value_and_gradient,
)

SIZES = [(5, 2, 30), (5, 2, 1), (5, 2, 2), (7, 3, 17), (1, 1, 5), (14, 5, 12)]


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "m", "steps"), SIZES)
@pytest.mark.parametrize("action_cost", [False, True])
@pytest.mark.parametrize("transform", [FirstOrder(), Cubature()])
def test_equals_the_generic_path(
    n: int, m: int, steps: int, action_cost: bool, transform: Transform
) -> None:
    check_paths(linear_case(n, m, steps, action_cost=action_cost), n, transform)


@pytest.mark.oracle
@pytest.mark.parametrize("features", [(Affine, Identity), (Identity, Affine), (Affine, Affine)])
def test_constant_terms_are_states_that_stay_one(
    features: tuple[Features, Features],
) -> None:
    check_paths(linear_case(4, 2, 9, action_cost=True, features=features), 4, FirstOrder())


def check_paths(case: LinearCase, n: int, transform: Transform) -> None:
    """The closed form against the generic path, with noise and a start."""
    g = torch.Generator().manual_seed(0)
    noise = {"nu": random_cost(g, n).expand(3, n, n).clone()}
    old, rule = case.generic, ResidualNoise(1.0)
    parts = (old.model, old.policy, case.reward, transform, old.horizon)
    choice = choose_path("closed_form", *parts, noise=rule, start_cov=random_cost(g, n))
    assert isinstance(choice.path, LinearMoment)
    arguments = (case.model, case.policy, noise, case.state)
    same_value_and_gradient(choice.path(*arguments), choice.generic(*arguments))


def value(
    theta: Tensor, F: Tensor, G: Tensor, start: Belief, noise: Tensor, cost: Tensor
) -> Tensor:
    weights = torch.tensor([0.9**t for t in range(8)], dtype=torch.float64)
    return moment_value_and_gradient(
        F - torch.eye(4),
        G,
        theta,
        start,
        noise,
        state_cost=cost,
        action_cost=cost[:2, :2],
        weights=weights,
    )[0]


def case() -> tuple[Tensor, ...]:
    g = torch.Generator().manual_seed(1)
    F, G, theta = 0.5 * normal(g, 2, 4, 4), normal(g, 2, 4, 2), 0.3 * normal(g, 2, 2, 4)
    noise = random_cost(g, 4).expand(2, 4, 4)
    return F, G, theta, normal(g, 2, 4), random_cost(g, 4).expand(2, 4, 4), noise, random_cost(g, 4)


def test_gradient_with_an_initial_covariance_against_finite_differences() -> None:
    F, G, theta, mean, cov, noise, cost = case()
    weights = torch.tensor([0.9**t for t in range(8)], dtype=torch.float64)
    start = Belief(mean, cov)
    _, gradient = moment_value_and_gradient(
        F - torch.eye(4),
        G,
        theta,
        start,
        noise,
        state_cost=cost,
        action_cost=cost[:2, :2],
        weights=weights,
    )
    for i, j in [(0, 0), (1, 2), (0, 3)]:
        shift = torch.zeros_like(theta)
        shift[:, i, j] = 1e-5
        up, down = (value(theta + s * shift, F, G, start, noise, cost) for s in (1, -1))
        assert torch.allclose(gradient[:, i, j], (up - down) / 2e-5, rtol=1e-7)


def test_without_noise_and_covariance_it_is_the_mean_alone() -> None:
    F, G, theta, mean, cov, noise, cost = case()
    weights = torch.tensor([0.9**t for t in range(8)], dtype=torch.float64)
    both = moment_value_and_gradient(
        F - torch.eye(4),
        G,
        theta,
        Belief(mean, torch.zeros_like(cov)),
        torch.zeros_like(noise),
        state_cost=cost,
        action_cost=None,
        weights=weights,
    )
    alone = mean_value_and_gradient(
        F - torch.eye(4), G, theta, mean, state_cost=cost, action_cost=None, weights=weights
    )
    assert torch.allclose(both[0], alone[0], rtol=1e-11)
    assert torch.allclose(both[1], alone[1], rtol=1e-9)


@pytest.mark.oracle
def test_value_is_the_average_over_noisy_rollouts() -> None:
    F, G, theta, mean, cov, noise, cost = case()
    g = torch.Generator().manual_seed(2)
    rollouts = 200_000
    A = (F + G @ theta)[0]
    chol, root = torch.linalg.cholesky(noise[0]), torch.linalg.cholesky(cov[0])
    s = mean[0] + normal(g, rollouts, 4) @ root.T
    total = torch.zeros(rollouts, dtype=torch.float64)
    for t in range(8):
        # Skewed noise: exactness needs the first two moments, not the normal law.
        z = -torch.log1p(-torch.rand(rollouts, 4, generator=g, dtype=torch.float64)) - 1
        s = s @ A.T + z @ chol.T
        a = s @ theta[0].T
        total -= 0.9**t * ((s @ cost * s).sum(-1) + (a @ cost[:2, :2] * a).sum(-1))
    expected = value(theta, F, G, Belief(mean, cov), noise, cost)[0]
    assert abs(float(total.mean() - expected)) < 5 * float(total.std()) / rollouts**0.5


def test_second_moments_stay_symmetric() -> None:
    F, G, theta, _, cov, noise, _ = case()
    moments, _ = second_moments(F + G @ theta, cov, noise, 40)
    assert torch.allclose(moments, moments.mT, rtol=1e-12, atol=1e-12 * float(moments.abs().max()))
