"""The linear closed loop of given parameters, which all closed forms start from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from edtorch.model.models import Model
from edtorch.policy.policies import LinearPolicy
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

    def of_weight(self, gradient: Tensor) -> Tensor:
        """dV/dtheta ``[B, m, N]`` as the gradient of the policy's weight."""
        dropped = self.augmented and not self.policy_has_constant
        return gradient[..., 1:] if dropped else gradient


def squared(matrix: Tensor) -> Tensor:
    """A cost or a covariance of s as one of (1, s): ``[*batch, n, n]`` to ``n + 1``."""
    return pad(matrix, (1, 0, 1, 0))


def linear_loop(
    model: Model,
    policy: LinearPolicy,
    model_parameters: Parameters,
    policy_parameters: Parameters,
    dt: float,
) -> LinearLoop:
    """The loop over ``dt`` seconds; ValueError if model or policy is not linear in the state."""
    weight = policy_parameters["weight"]
    dynamics = model.linear_dynamics(model_parameters["weight"], dt)
    gain = policy.linear_gain(weight)
    if dynamics is None or gain is None:
        raise ValueError("the closed loop is not linear in the state: no closed form")
    drift, G, constant = dynamics
    affine = gain.constant is not None
    if constant is None and not affine:
        return LinearLoop(drift, G, gain.state, False, False)
    if constant is None:
        constant = torch.zeros_like(drift[..., 0])
    # The weights of an affine policy have the constant first, as the augmented state has the 1.
    theta = weight if affine else pad(weight, (1, 0))
    rows = torch.cat([constant.unsqueeze(-1), drift], dim=-1)
    return LinearLoop(pad(rows, (0, 0, 1, 0)), pad(G, (0, 0, 1, 0)), theta, True, affine)


def closed(drift: Tensor, G: Tensor, theta: Tensor) -> Tensor:
    """A = I + drift + G theta, ``[B, N, N]``."""
    A = torch.baddbmm(drift, G, theta)
    A.diagonal(dim1=-2, dim2=-1).add_(1)
    return A
