"""The value of a policy and its gradient, for any model."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Affine, Pairwise
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import SquashedPolicy
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder, MeanOnly, Transform, point_belief
from edtorch.types import Belief
from edtorch.value.unroll import FromOrigin, Generic, Horizon
from tests.systems import f64, linear_case, normal, random_cost, same_value_and_gradient


def nonlinear(transform: Transform, kind: type, steps: int = 6) -> Generic:
    """Pairwise model, squashed affine policy, cost on state and action."""
    g = torch.Generator().manual_seed(0)
    model = kind(3, 2, Pairwise(5), torch.zeros(3, dtype=torch.float64))
    policy = SquashedPolicy(3, 2, Affine(3))
    reward = QuadraticReward(random_cost(g, 3), random_cost(g, 2))
    horizon = Horizon(steps, 0.1, 0.9, 0.1)
    return Generic(model, policy, reward, transform, horizon, ResidualNoise(1.0))


def parameters(path: Generic, batch: int) -> tuple[dict, dict, dict, Tensor]:
    g = torch.Generator().manual_seed(1)
    return (
        {"weight": 0.3 * normal(g, batch, *path.model.initial([0])["weight"].shape[1:])},
        {"weight": 0.5 * normal(g, batch, *path.policy.initial([0])["weight"].shape[1:])},
        {"nu": random_cost(g, 3).expand(batch, 3, 3).clone()},
        normal(g, batch, 3),
    )


@pytest.mark.oracle
@pytest.mark.parametrize("transform", [MeanOnly(), FirstOrder()])
@pytest.mark.parametrize("kind", [DerivativeModel, NextStateModel])
def test_gradient_against_finite_differences(transform: Transform, kind: type) -> None:
    path = nonlinear(transform, kind)
    model, policy, noise, state = parameters(path, 2)
    gradient = path(model, policy, noise, state).gradient["weight"]
    theta = policy["weight"]
    step = 1e-5
    for index in [(0, 0), (1, 2), (0, 3)]:
        shifted = torch.zeros_like(theta)
        shifted[:, index[0], index[1]] = step
        up = path(model, {"weight": theta + shifted}, noise, state).value
        down = path(model, {"weight": theta - shifted}, noise, state).value
        numeric = (up - down) / (2 * step)
        assert torch.allclose(gradient[:, index[0], index[1]], numeric, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("transform", [MeanOnly(), FirstOrder()])
def test_batch_gradient_is_the_vmap_of_single_gradients(transform: Transform) -> None:
    path = nonlinear(transform, DerivativeModel, steps=4)
    model, policy, noise, state = parameters(path, 3)
    together = path(model, policy, noise, state)

    def value(w: Tensor, theta: Tensor, nu: Tensor, s: Tensor) -> Tensor:
        trajectory = path.trajectory({"weight": w}, {"weight": theta}, {"nu": nu}, point_belief(s))
        return trajectory.value

    single = torch.func.vmap(torch.func.grad(value, argnums=1))(
        model["weight"], policy["weight"], noise["nu"], state
    )
    assert torch.allclose(together.gradient["weight"], single, rtol=1e-11, atol=1e-14)


def test_value_is_the_weighted_sum_of_the_rewards() -> None:
    path = nonlinear(FirstOrder(), DerivativeModel)
    model, policy, noise, state = parameters(path, 2)
    trajectory = path.trajectory(model, policy, noise, point_belief(state))
    weights = f64([0.1 * 0.9 ** (0.1 * tau) for tau in range(6)])
    assert trajectory.mean.shape == (7, 2, 3) and trajectory.cov.shape == (7, 2, 3, 3)
    assert torch.allclose(trajectory.value, weights @ trajectory.reward, rtol=1e-13)


def test_discrete_form_discounts_by_step() -> None:
    assert Horizon(3, 0.01, 0.5, 1.0).weights() == [1.0, 0.5, 0.25]


def test_gradient_is_finite_from_a_point_belief_and_from_any_belief() -> None:
    path = nonlinear(FirstOrder(), DerivativeModel)
    model, policy, noise, state = parameters(path, 2)
    start = Belief(state, torch.zeros(2, 3, 3).double())

    def value(theta: Tensor) -> Tensor:
        return path.trajectory(model, {"weight": theta}, noise, start).value.sum()

    gradient = torch.func.grad(value)(policy["weight"])
    assert bool(gradient.isfinite().all())
    again = path(model, policy, noise, state).gradient["weight"]
    assert torch.allclose(gradient, again, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0.1, 1.0, 1.0), "horizon=0"),
        ((3, 0.0, 1.0, 1.0), "dt=0.0"),
        ((3, 0.1, 0.0, 1.0), "discount=0.0"),
        ((3, 0.1, 1.5, 1.0), "discount=1.5"),
    ],
)
def test_refuses_the_impossible(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Horizon(*arguments)


def test_from_the_origin_every_state_is_the_same() -> None:
    case = linear_case(3, 2, 6)
    path = FromOrigin(case.closed)
    zero = torch.zeros_like(case.state)
    found = path(case.model, case.policy, case.noise, case.state)
    same_value_and_gradient(found, case.closed(case.model, case.policy, case.noise, zero))
    assert not path.needs_autograd and FromOrigin(case.generic).needs_autograd
