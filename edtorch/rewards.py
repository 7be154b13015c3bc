"""Shaping rewards r(s, a), and their expectation under a belief (eq. 1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor
from torch.func import jacrev

from edtorch.types import Belief

StateFunction = Callable[[Tensor], Tensor]
"""A function of states that works row by row: ``[*batch, n] -> [*batch, ...]``."""


class Reward(Protocol):
    """r(s, a), ``[*batch]``, of states ``[*batch, n]`` and actions ``[*batch, m]``, scaled."""

    def __call__(self, state: Tensor, action: Tensor) -> Tensor:
        """The reward of each row."""
        ...


class QuadraticReward:
    """r(s, a) = -(s' Q s + a' R a), in scaled units.

    state_cost Q ``[n, n]`` and action_cost R ``[m, m]`` are symmetric and positive semidefinite
    (ValueError otherwise).  The paper's bicycle: Q weighs the squared angle to the goal with 1 and
    the squared lean with 10, R = 0 (section 4).
    """

    def __init__(self, state_cost: Tensor, action_cost: Tensor) -> None:
        for name, cost in (("state_cost", state_cost), ("action_cost", action_cost)):
            if cost.ndim != 2 or cost.shape[0] != cost.shape[1]:
                raise ValueError(f"{name} has shape {tuple(cost.shape)}, expected a square matrix")
            if not torch.allclose(cost, cost.T):
                raise ValueError(f"{name} is not symmetric")
            smallest = torch.linalg.eigvalsh(cost)[0].item()
            if smallest < -1e-12 * cost.abs().max().item():
                raise ValueError(f"{name} has eigenvalue {smallest:.3g}, expected all >= 0")
        self.state_cost = state_cost
        self.action_cost = action_cost
        self.costs_actions = bool((action_cost != 0).any())

    def __call__(self, state: Tensor, action: Tensor) -> Tensor:
        """-(s' Q s + a' R a), ``[*batch]``."""
        cost = (state @ self.state_cost * state).sum(-1)
        if self.costs_actions:
            cost = cost + (action @ self.action_cost * action).sum(-1)
        return -cost


def rowwise_jacobian(function: StateFunction, state: Tensor) -> Tensor:
    """Jacobian of a row-by-row ``function`` at each row of ``state`` by ``torch.func.jacrev``.

    state ``[*batch, n]``, function ``[*batch, n] -> [*batch, p]``; returns ``[*batch, p, n]``.
    Rows do not mix, so the Jacobian of the sum over rows holds every row's own Jacobian.
    """

    def summed(x: Tensor) -> Tensor:
        out = function(x)
        return out.reshape(-1, out.shape[-1]).sum(0)

    jacobian = jacrev(summed)(state)
    return torch.movedim(jacobian, 0, -2)


def expected_reward(reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
    """E[r_pi] = r_pi(mean) + 1/2 tr(D^2 r_pi(mean) cov) (eq. 1; Fig. 1 step 6c), ``[*batch]``.

    r_pi(s) = r(s, pi(s)): the Hessian includes the policy.  Exact for quadratic r_pi and any
    distribution with this mean and covariance; second order otherwise.
    """

    def gradient(s: Tensor) -> Tensor:
        return rowwise_jacobian(lambda x: reward(x, policy(x)).unsqueeze(-1), s).squeeze(-2)

    hessian = rowwise_jacobian(gradient, belief.mean)
    mean_reward = reward(belief.mean, policy(belief.mean))
    return mean_reward + 0.5 * (hessian * belief.cov).sum((-1, -2))
