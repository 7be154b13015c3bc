"""Rewards and their expectation (eq. 1)."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.derivatives import rowwise_jacobian
from edtorch.rewards import QuadraticReward, expected_reward
from edtorch.types import Belief
from tests.systems import normal, random_cost


def quadratic(n: int = 3, m: int = 2) -> QuadraticReward:
    g = torch.Generator().manual_seed(0)
    return QuadraticReward(random_cost(g, n), random_cost(g, m))


def test_quadratic_reward_by_hand() -> None:
    reward = QuadraticReward(torch.diag(torch.tensor([10.0, 1.0])), torch.tensor([[2.0]]))
    r = reward(torch.tensor([[1.0, 3.0]]), torch.tensor([[0.5]]))
    assert r.tolist() == [-(10 + 9 + 0.5)]


def test_rowwise_jacobian_is_jacrev_of_each_row() -> None:
    x = normal(torch.Generator().manual_seed(1), 4, 2, 3)

    def function(s: Tensor) -> Tensor:
        return torch.stack([s.prod(-1), s[..., 0].sin() * s[..., 1]], dim=-1)

    wanted = torch.func.vmap(torch.func.vmap(torch.func.jacrev(function)))(x)
    assert torch.allclose(rowwise_jacobian(function, x), wanted, rtol=1e-14)


@pytest.mark.oracle
@pytest.mark.parametrize("law", ["normal", "skewed"])
def test_expectation_is_exact_for_quadratics_under_any_law(law: str) -> None:
    g = torch.Generator().manual_seed(2)
    reward, gain, root = quadratic(), normal(g, 2, 3), normal(g, 3, 3)
    mean = normal(g, 3)
    z = normal(g, 400_000, 3)
    if law == "skewed":
        z = -torch.log(torch.rand(z.shape, generator=g, dtype=torch.float64)) - 1
    s = mean + z @ root.T
    samples = reward(s, s @ gain.T)
    belief = Belief(mean, root @ root.T)
    expected = expected_reward(reward, belief, lambda x: x @ gain.T)
    error = float(samples.mean() - expected)
    assert abs(error) < 5 * float(samples.std()) / 400_000**0.5


def test_hessian_includes_the_policy() -> None:
    # r = -a^2 with a = s^3 is -s^6: its second derivative at 1 is -30.
    reward = QuadraticReward(torch.zeros(1, 1).double(), torch.ones(1, 1).double())
    belief = Belief(torch.ones(2, 1).double(), torch.full((2, 1, 1), 0.01, dtype=torch.float64))
    expected = expected_reward(reward, belief, lambda s: s**3)
    assert expected.tolist() == pytest.approx([-1 - 0.15] * 2, rel=1e-12)


def test_curvature_of_the_reward_through_the_policy_against_finite_differences() -> None:
    # A squashed policy makes r_pi far from quadratic although r is quadratic.
    g = torch.Generator().manual_seed(3)
    reward, gain, mean, cov = quadratic(), normal(g, 2, 3), normal(g, 3), random_cost(g, 3)

    def policy(s: Tensor) -> Tensor:
        return torch.tanh(s @ gain.T)

    def closed(s: Tensor) -> Tensor:
        return reward(s, policy(s))

    h = 1e-4
    steps = h * torch.eye(3).double()
    hessian = torch.stack(
        [
            torch.stack(
                [
                    (closed(mean + u + v) - closed(mean + u - v) - closed(mean - u + v))
                    + closed(mean - u - v)
                    for v in steps
                ]
            )
            for u in steps
        ]
    ) / (4 * h * h)
    wanted = closed(mean) + 0.5 * (hessian * cov).sum()
    expected = expected_reward(reward, Belief(mean, cov), policy)
    assert torch.allclose(expected, wanted, rtol=1e-5)
    # Without the policy's curvature it would be another number.
    slope = torch.func.jacrev(policy)(mean)
    naive = expected_reward(
        reward, Belief(mean, cov), lambda s: policy(mean) + (s - mean) @ slope.T
    )
    assert abs(float(naive - wanted)) > 1e-3 * abs(float(wanted))


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (torch.ones(2, 3), "state_cost has shape"),
        (torch.tensor([[1.0, 2.0], [0.0, 1.0]]), "not symmetric"),
        (torch.diag(torch.tensor([1.0, -1.0])), "eigenvalue -1"),
    ],
)
def test_refuses_what_is_no_cost(cost: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        QuadraticReward(cost, torch.zeros(1, 1))
