"""The linear closed loop of given parameters, which all closed forms start from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from edtorch.model.models import Model, dynamics_of
from edtorch.policy.policies import LinearGain, Policy, gain_of
from edtorch.shapes import ActionCost, CrossCost, Gains, Inputs, Squares, StateCost
from edtorch.types import Parameters


@dataclass(frozen=True)
class LinearLoop:
    """s' = s + (drift + G theta) s, where s is the state, or (1, state) if something is constant.

    drift ``[B, N, N]``, G ``[B, N, m]``, theta ``[B, m, N]``; N = n, or n + 1 if the model or the
    policy has a constant term (``augmented``): the first component is then 1 and stays so.
    """

    drift: Tensor
    G: Tensor
    theta: Tensor
    augmented: bool
    policy_has_constant: bool

    def start(self, state: Tensor) -> Tensor:
        """``[B, n] -> [B, N]``."""
        return pad(state, (1, 0), value=1.0) if self.augmented else state

    def square(self, matrix: Tensor) -> Tensor:
        """A cost or a covariance: ``[*batch, n, n] -> [*batch, N, N]``."""
        return squared(matrix) if self.augmented else matrix

    def gain(self, gradient: Tensor) -> LinearGain:
        """dV/dtheta ``[B, m, N]`` as the gradient with respect to the policy's gain."""
        if not self.augmented:
            return LinearGain(gradient, None)
        return LinearGain(gradient[..., 1:], gradient[..., 0] if self.policy_has_constant else None)


def squared(matrix: Tensor) -> Tensor:
    """A cost or a covariance of s as one of (1, s): ``[*batch, n, n]`` to ``n + 1``."""
    return pad(matrix, (1, 0, 1, 0))


def loop_cost(
    state_cost: StateCost, action_cost: ActionCost | None, cross: CrossCost | None, theta: Gains
) -> Squares:
    """C = Q + theta'R theta + N theta + theta'N' ``[B, N, N]``, the cost along a = theta s.

    state_cost Q ``[N, N]``, action_cost R ``[m, m]`` and cross N ``[N, m]``, None for zero.
    """
    cost = state_cost.expand(theta.shape[0], *state_cost.shape)
    if action_cost is not None:
        cost = cost + theta.mT @ action_cost @ theta
    if cross is not None:
        both = cross @ theta
        cost = cost + both + both.mT
    return cost


def priced_actions(
    gradient: Gains,
    action_cost: ActionCost | None,
    cross: CrossCost | None,
    theta: Gains,
    moment: Squares,
) -> Gains:
    """dV/dtheta with what the actions cost of themselves: ``gradient`` - 2 (R theta + N') M.

    moment M ``[B, N, N]``: the weighted sum of the second moments; the rest as in ``loop_cost``.
    """
    if action_cost is not None:
        gradient = gradient - 2 * action_cost @ theta @ moment
    if cross is not None:
        gradient = gradient - 2 * cross.mT @ moment
    return gradient


def linear_loop(
    model: Model,
    policy: Policy,
    model_parameters: Parameters,
    policy_parameters: Parameters,
    dt: float,
    augmented: bool = False,
) -> LinearLoop:
    """The loop over ``dt`` seconds; ValueError if model or policy is not linear in the state.

    augmented: of (1, state) even if nothing in the loop is constant, for rewards in which something
    is.
    """
    dynamics, gain = dynamics_of(model, model_parameters, dt), gain_of(policy, policy_parameters)
    if dynamics is None or gain is None:
        raise ValueError("the closed loop is not linear in the state: no closed form")
    drift, G, constant = dynamics
    affine = gain.constant is not None
    if constant is None and not affine and not augmented:
        return LinearLoop(drift, G, gain.state, False, False)
    if constant is None:
        constant = torch.zeros_like(drift[..., 0])
    theta = pad(gain.state, (1, 0))
    if gain.constant is not None:
        theta = torch.cat([gain.constant.unsqueeze(-1), gain.state], dim=-1)
    rows = torch.cat([constant.unsqueeze(-1), drift], dim=-1)
    return LinearLoop(pad(rows, (0, 0, 1, 0)), pad(G, (0, 0, 1, 0)), theta, True, affine)


def closed(drift: Squares, G: Inputs, theta: Gains) -> Squares:
    """A = I + drift + G theta, ``[B, N, N]``."""
    A = torch.baddbmm(drift, G, theta)
    A.diagonal(dim1=-2, dim2=-1).add_(1)
    return A
