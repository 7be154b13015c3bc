"""Shaping rewards r(s, a), and their expectation under a belief (eq. 1)."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction, rowwise_jacobian, scalar_curvature
from edtorch.types import Belief


class Reward(Protocol):
    """r(s, a), ``[*batch]``, of states ``[*batch, n]`` and actions ``[*batch, m]``, scaled.

    Two optional attributes are read where they exist: ``smooth = False`` declares that r has no
    second derivatives everywhere, and is refused by transforms that take them; ``actions`` is the
    m that r expects, for the checks of ``edtorch.value.checks``.
    """

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
        self.actions = action_cost.shape[0]
        self.costs_actions = bool((action_cost != 0).any())

    def __call__(self, state: Tensor, action: Tensor) -> Tensor:
        """-(s' Q s + a' R a), ``[*batch]``."""
        cost = (state @ self.state_cost * state).sum(-1)
        if self.costs_actions:
            cost = cost + (action @ self.action_cost * action).sum(-1)
        return -cost


def expected_reward(reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
    """E[r_pi] = r_pi(mean) + 1/2 tr(D^2 r_pi(mean) cov) (eq. 1; Fig. 1 step 6c), ``[*batch]``.

    r_pi(s) = r(s, pi(s)): the curvature includes the policy's.  Exact for quadratic r_pi and any
    distribution with this mean and covariance; second order otherwise.
    """

    def closed(s: Tensor) -> Tensor:
        return reward(s, policy(s))

    return closed(belief.mean) + 0.5 * scalar_curvature(closed, belief.mean, belief.cov)


__all__ = ["QuadraticReward", "Reward", "StateFunction", "expected_reward", "rowwise_jacobian"]
