"""Policies pi(s), and the noise added to them for exploration."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from edtorch.linalg import matvec
from edtorch.model.features import Affine, FeatureMap, Identity
from edtorch.types import Parameters


class LinearGain(NamedTuple):
    """pi(s) = state s + constant: ``[*batch, m, n]``, and ``[*batch, m]`` or None for zero."""

    state: Tensor
    constant: Tensor | None


class LinearPolicy(nn.Module):
    """pi(s) = theta . phi(s) (section 4), with ``weight`` theta ``[m, k]`` that starts at zero.

    states n, actions m; features: a map of n inputs.  The module is a template, as ``LinearModel``.
    """

    def __init__(
        self, states: int, actions: int, features: FeatureMap, dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        if features.inputs != states:
            raise ValueError(
                f"the policy's feature map takes {features.inputs} inputs, expected {states} states"
            )
        self.features = features
        self.weight = nn.Parameter(torch.zeros(actions, features.outputs, dtype=dtype))

    def forward(self, state: Tensor) -> Tensor:
        """``[*batch, n] -> [*batch, m]``."""
        return self.action({"weight": self.weight}, state)

    def action(self, parameters: Parameters, state: Tensor) -> Tensor:
        """``forward`` with these parameters; in the loop, ``functional_call`` would cost more.

        A ``limit`` ``[*batch, n]`` among them bounds what is seen of the state
        (``edtorch.learner.limit``).
        """
        limit = parameters.get("limit")
        if limit is not None:
            state = bounded(state, limit)
        return matvec(parameters["weight"], self.features(state))

    def linear_gain(self, weight: Tensor) -> LinearGain | None:
        """What the weights ``[*batch, m, k]`` mean if pi is linear or affine in the state."""
        if isinstance(self.features, Affine):
            return LinearGain(weight[..., 1:], weight[..., 0])
        return LinearGain(weight, None) if isinstance(self.features, Identity) else None


class SquashedPolicy(LinearPolicy):
    """pi(s) = tanh(theta . phi(s)): actions bounded by their scale, smooth at the bound."""

    def action(self, parameters: Parameters, state: Tensor) -> Tensor:
        """``[*batch, n] -> [*batch, m]`` in (-1, 1)."""
        return torch.tanh(super().action(parameters, state))

    def linear_gain(self, weight: Tensor) -> LinearGain | None:
        """None: never linear."""
        return None


def bounded(state: Tensor, limit: Tensor) -> Tensor:
    """The state ``[*batch, n]`` with each component within ``limit`` ``[*batch, n]`` of zero."""
    return torch.minimum(torch.maximum(state, -limit), limit)


def explore(action: Tensor, normal: Tensor, deviation: float | Tensor) -> Tensor:
    """action + N(0, deviation^2) (section 4), the deviation in scaled units, a number or one for
    each learner ``[*batch, 1]``; normal like action."""
    return action + deviation * normal
