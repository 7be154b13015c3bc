"""One step of belief (eq. 2) against closed forms and Monte Carlo."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.rewards import QuadraticReward
from edtorch.transform import ConstantNoise, FirstOrder, MeanOnly, point_belief
from edtorch.types import Belief
from tests.systems import f64, normal, random_cost


def test_first_order_is_exact_for_linear_systems() -> None:
    g = torch.Generator().manual_seed(0)
    A, W, S = normal(g, 3, 3), random_cost(g, 3), random_cost(g, 3)
    mean, steps = normal(g, 3), 7
    belief = Belief(mean, S)
    for _ in range(steps):
        belief = FirstOrder().move(
            belief, lambda s: (A @ s.unsqueeze(-1)).squeeze(-1), ConstantNoise(W)
        )
    power = torch.linalg.matrix_power(A, steps)
    noise = sum(
        (
            torch.linalg.matrix_power(A, j) @ W @ torch.linalg.matrix_power(A, j).T
            for j in range(steps)
        ),
        torch.zeros_like(W),
    )
    assert torch.allclose(belief.mean, power @ mean, rtol=1e-12)
    assert torch.allclose(belief.cov, power @ S @ power.T + noise, rtol=1e-12)


@pytest.mark.oracle
def test_first_order_is_of_first_order_in_the_covariance() -> None:
    # mu(s) = sin s, s ~ N(m, v): mean e^{-v/2} sin m; the first-order error is of the order of v.
    m = 0.8
    errors = []
    for v in (0.04, 0.01):
        belief = Belief(f64([m]), f64([[v]]))
        moved = FirstOrder().move(belief, torch.sin, ConstantNoise(torch.zeros(1, 1).double()))
        assert float(moved.cov) == pytest.approx(v * math.cos(m) ** 2, rel=1e-12)
        errors.append(abs(float(moved.mean) - math.exp(-v / 2) * math.sin(m)))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_covariance_stays_symmetric_and_positive() -> None:
    g = torch.Generator().manual_seed(1)
    A = 1.3 * normal(g, 5, 4, 4)
    belief = point_belief(normal(g, 5, 4))
    noise = ConstantNoise(random_cost(g, 4).expand(5, 4, 4))

    def closed_loop(s: Tensor) -> Tensor:
        return torch.tanh((A @ s.unsqueeze(-1)).squeeze(-1)) + s

    for _ in range(40):
        belief = FirstOrder().move(belief, closed_loop, noise)
        assert torch.equal(belief.cov, belief.cov.mT)
        smallest = torch.linalg.eigvalsh(belief.cov)[:, 0]
        largest = torch.linalg.eigvalsh(belief.cov)[:, -1]
        assert bool((smallest >= -1e-12 * largest).all())


def test_mean_only_moves_the_mean_and_takes_the_reward_there() -> None:
    reward = QuadraticReward(torch.eye(1).double(), torch.zeros(1, 1).double())
    belief = Belief(torch.tensor([2.0]).double(), torch.tensor([[3.0]]).double())
    moved = MeanOnly().move(belief, lambda s: s / 2, ConstantNoise(torch.ones(1, 1).double()))
    assert float(moved.mean) == 1 and float(moved.cov) == 3
    assert float(MeanOnly().reward(reward, belief, torch.zeros_like)) == -4
    assert float(FirstOrder().reward(reward, belief, torch.zeros_like)) == -7


def test_point_belief() -> None:
    belief = point_belief(torch.ones(2, 3))
    assert belief.cov.shape == (2, 3, 3) and not bool(belief.cov.any())
