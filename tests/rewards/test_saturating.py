"""exp(-d^2 / 2) - 1: its expectation under a Gaussian, and that transforms take it."""

from __future__ import annotations

import pytest
import torch

from edtorch.rewards import PhysicalReward, SaturatingReward, expected_reward
from edtorch.transform import Cubature, FirstOrder
from edtorch.types import Belief
from tests.systems import normal, random_cost

NAMES = ("x", "v", "goal")


def reward() -> SaturatingReward:
    return SaturatingReward(NAMES, {"x": 0.8, "v": 1.5}, {"x": "goal", "v": 0.3})


def test_by_hand() -> None:
    found = reward()(torch.tensor([[1.0, 0.3, 0.2]]).double())
    assert found.item() == pytest.approx(torch.tensor(-0.5).double().exp().item() - 1)


@pytest.mark.oracle
def test_expectation_against_monte_carlo() -> None:
    g = torch.Generator().manual_seed(0)
    root, mean = 0.7 * normal(g, 3, 3), normal(g, 3)
    samples = reward()(mean + normal(g, 400_000, 3) @ root.T)
    found = reward().expected(Belief(mean, root @ root.T))
    assert abs(samples.mean() - found) < 5 * samples.std() / 400_000**0.5


def test_gradient_against_finite_differences() -> None:
    g = torch.Generator().manual_seed(1)
    mean, root = normal(g, 2, 3).requires_grad_(), normal(g, 2, 3, 3).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda m, r: reward().expected(Belief(m, r @ r.mT)), (mean, root)
    )


def test_without_covariance_it_is_the_reward() -> None:
    g = torch.Generator().manual_seed(2)
    s = normal(g, 4, 3)
    found = reward().expected(Belief(s, torch.zeros(4, 3, 3).double()))
    assert torch.allclose(found, reward()(s), rtol=1e-14)


def test_transforms_take_the_expectation_in_any_units() -> None:
    g = torch.Generator().manual_seed(3)
    mean, cov = normal(g, 4, 3), random_cost(g, 3).expand(4, 3, 3)
    scale = torch.tensor([0.5, 2.0, 0.5]).double()
    scaled = PhysicalReward(reward(), scale, torch.ones(1).double())
    wanted = reward().expected(Belief(mean, cov))
    belief = Belief(mean / scale, cov / (scale.unsqueeze(-1) * scale))

    def still(s: torch.Tensor) -> torch.Tensor:
        return s[..., :1]

    for found in (
        expected_reward(scaled, belief, still),
        FirstOrder().reward(scaled, belief, still),
        Cubature().reward(scaled, belief, still),
    ):
        assert torch.allclose(found, wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("width", "target", "message"),
    [
        ({}, None, "width={}: expected one"),
        ({"y": 1.0}, None, "width.y=1.0: expected one of x, v, goal"),
        ({"x": 0.0}, None, "width.x=0.0: expected a number > 0"),
        ({"x": 1.0}, {"v": 1.0}, "target.v=1.0: has no effect without width.v"),
        ({"x": 1.0}, {"x": "y"}, "target.x=y: expected a number or another"),
    ],
)
def test_refusals(width: dict[str, float], target: dict | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SaturatingReward(NAMES, width, target)
