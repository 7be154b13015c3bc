"""Policies pi(s), and the noise added to them for exploration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from edtorch.initial import population
from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.model.features import FeatureMap, linear_part
from edtorch.shapes import Actions, States
from edtorch.types import Parameters


class Policy(Protocol):
    """pi(s) with the parameters of a whole population, ``[B, ...]`` each, by any names.

    Optional members, asked for by ``gain_of`` and ``policy_label``:

    * ``linear_gain(parameters) -> LinearGain | None`` where pi is linear or affine in the state,
      with ``of_gain(LinearGain) -> Parameters``, which turns a gradient with respect to the gain
      into one with respect to the parameters.  Closed forms of the value need both;
    * ``label``: what a saved policy is called.

    ``edtorch.policy.module.ModulePolicy`` makes a policy of any ``nn.Module`` from states to
    actions.
    """

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The first parameters, one set per seed, a function of that seed alone."""
        ...

    def action(self, parameters: Parameters, state: States, /) -> Actions:
        """``[*more, B, n] -> [*more, B, m]``, both scaled.

        There may be further parameters, which are not the policy's: a ``limit`` ``[B, n]`` bounds
        what is seen of the state (``edtorch.learner.limit``).
        """
        ...


class LinearGain(NamedTuple):
    """pi(s) = state s + constant: ``[*batch, m, n]``, and ``[*batch, m]`` or None for zero."""

    state: Tensor
    constant: Tensor | None


class GainedPolicy(Policy, Protocol):
    """A policy that closed forms can use."""

    def linear_gain(self, parameters: Parameters) -> LinearGain | None:
        """See ``Policy``."""
        ...

    def of_gain(self, gain: LinearGain) -> Parameters:
        """See ``Policy``."""
        ...


def gain_of(policy: Policy, parameters: Parameters) -> LinearGain | None:
    """The policy's linear gain, None where it has none."""
    offered = getattr(policy, "linear_gain", None)
    return None if offered is None else offered(parameters)


def policy_label(policy: object) -> str:
    """What a saved policy is called: its ``label``, else its class."""
    return getattr(policy, "label", type(policy).__name__)


class LinearPolicy(nn.Module):
    """pi(s) = theta . phi(s) (section 4), with ``weight`` theta ``[m, k]`` that starts at zero.

    states n, actions m; features: a map of n inputs.  The module is a template, as ``LinearModel``.
    """

    linear_in_features = True

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

    @property
    def label(self) -> str:
        """Class and feature map."""
        return f"{type(self).__name__}({type(self.features).__name__})"

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The template's parameters, the same for every seed: zero."""
        return population(self, len(seeds))

    def forward(self, state: States) -> Actions:
        """``[*batch, n] -> [*batch, m]``."""
        return self.action({"weight": self.weight}, state)

    def action(self, parameters: Parameters, state: States) -> Actions:
        """``forward`` with these parameters; in the loop, ``functional_call`` would cost more.

        A ``limit`` ``[*batch, n]`` among them bounds what is seen of the state
        (``edtorch.learner.limit``).
        """
        return matvec(parameters["weight"], self.features(limited(parameters, state)))

    def linear_gain(self, parameters: Parameters) -> LinearGain | None:
        """What the ``weight`` ``[*batch, m, k]`` means if pi is linear or affine in the state."""
        part = linear_part(self.features, parameters["weight"])
        return None if part is None else LinearGain(part.matrix, part.constant)

    def law(self, parameters: Arrays) -> Law | None:
        """``action`` of one state ``[n]`` (``edtorch.law``); None unless it is linear."""
        gain = self.linear_gain({"weight": torch.from_numpy(parameters["weight"])})
        if gain is None or type(self).action is not LinearPolicy.action:
            return None
        matrix, limit = gain.state.numpy(), parameters.get("limit")
        constant = 0.0 if gain.constant is None else gain.constant.numpy()
        if limit is None:
            return lambda state: matrix @ state + constant
        return lambda state: matrix @ np.minimum(np.maximum(state, -limit), limit) + constant

    def of_gain(self, gain: LinearGain) -> Parameters:
        """A gradient with respect to the gain as one with respect to the ``weight``."""
        if gain.constant is None:
            return {"weight": gain.state}
        return {"weight": torch.cat([gain.constant.unsqueeze(-1), gain.state], dim=-1)}


class CentredPolicy(LinearPolicy):
    """An affine policy that starts at the middle of the range of each action.

    middle ``[m]``: scaled.  Where the range is not symmetric about zero (a thrust), zero is a
    bound. ValueError unless the features begin with a constant.
    """

    def __init__(
        self,
        states: int,
        actions: int,
        features: FeatureMap,
        middle: Tensor,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__(states, actions, features, dtype)
        gain = self.linear_gain({"weight": self.weight})
        if gain is None or gain.constant is None:
            raise ValueError("features: expected affine ones, for the constant that it starts at")
        with torch.no_grad():
            self.weight[:, 0] = middle


class SquashedPolicy(LinearPolicy):
    """pi(s) = tanh(theta . phi(s)): actions bounded by their scale, smooth at the bound."""

    def action(self, parameters: Parameters, state: States) -> Actions:
        """``[*batch, n] -> [*batch, m]`` in (-1, 1)."""
        return torch.tanh(super().action(parameters, state))

    def linear_gain(self, parameters: Parameters) -> LinearGain | None:
        """None: never linear."""
        return None


def limited(parameters: Parameters, state: Tensor) -> Tensor:
    """The state ``[*batch, n]`` as far as a ``limit`` among the parameters lets it be seen."""
    limit = parameters.get("limit")
    return state if limit is None else bounded(state, limit)


def bounded(state: Tensor, limit: Tensor) -> Tensor:
    """The state ``[*batch, n]`` with each component within ``limit`` ``[*batch, n]`` of zero."""
    return torch.minimum(torch.maximum(state, -limit), limit)


def explore(action: Tensor, normal: Tensor, deviation: float | Tensor) -> Tensor:
    """action + N(0, deviation^2) (section 4), the deviation in scaled units, a number or one for
    each learner ``[*batch, 1]``; normal like action."""
    return action + deviation * normal
