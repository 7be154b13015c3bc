"""The unroll of a linear-quadratic problem is the Lyapunov value, its gradient the formula."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.model.models import NextStateModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder
from edtorch.types import Belief
from edtorch.value.unroll import Generic, Horizon
from tests.systems import normal, random_cost

GAMMA, T = 0.93, 7


class Case:
    """s' = A s + B a + noise(W), a = -K s, cost Q and R, start (m, S0): section 3's definition."""

    def __init__(self, n: int, m: int) -> None:
        g = torch.Generator().manual_seed(10 * n + m)
        self.A, self.B = normal(g, n, n) / n**0.5, normal(g, n, m)
        self.K = 0.4 * normal(g, m, n)
        self.Q, self.R = random_cost(g, n), random_cost(g, m)
        self.mean, self.S0, self.W = normal(g, n), random_cost(g, n), random_cost(g, n)
        self.F = self.A - self.B @ self.K
        self.costs = [self.Q + self.K.mT @ self.R @ self.K]
        for _ in range(T):
            self.costs.append(self.costs[0] + GAMMA * self.F.mT @ self.costs[-1] @ self.F)

    def unrolled(self, K: Tensor) -> Tensor:
        """V' by the product's generic path."""
        n, m = self.B.shape
        model = NextStateModel(n, m, Identity(n + m), torch.zeros(n, dtype=torch.float64))
        path = Generic(
            model,
            LinearPolicy(n, m, Identity(n)),
            QuadraticReward(self.Q, self.R),
            FirstOrder(),
            Horizon(T, 1.0, GAMMA, 1.0, "definition"),
            ResidualNoise(1.0),
        )
        weight = torch.cat([self.A, self.B], dim=-1)
        start = Belief(self.mean, self.S0)
        noise = {"nu": self.W}
        return path.trajectory({"weight": weight}, {"weight": -K}, noise, start).value

    def value(self) -> Tensor:
        """By the backward recursion."""
        total = self.mean @ self.costs[T] @ self.mean + (self.costs[T] * self.S0).sum()
        for j in range(1, T + 1):
            total = total + GAMMA**j * (self.costs[T - j] * self.W).sum()
        return -total

    def gradient(self) -> Tensor:
        """dV'/dK by the formula."""
        X = torch.outer(self.mean, self.mean) + self.S0
        total = torch.zeros_like(self.K)
        for k in range(T + 1):
            total = total + GAMMA**k * self.R @ self.K @ X
            if k < T:
                ahead = self.costs[T - k - 1]
                total = total - GAMMA ** (k + 1) * self.B.mT @ ahead @ self.F @ X
            X = self.F @ X @ self.F.mT + self.W
        return -2 * total


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (5, 2), (14, 5)])
def test_value_and_gradient(n: int, m: int) -> None:
    case = Case(n, m)
    assert float(case.unrolled(case.K)) == pytest.approx(float(case.value()), rel=1e-12)
    gradient = torch.func.grad(case.unrolled)(case.K)
    wanted = case.gradient()
    assert torch.allclose(gradient, wanted, rtol=1e-10, atol=1e-10 * float(wanted.abs().max()))
