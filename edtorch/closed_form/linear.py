"""The linear closed loop of given parameters, which all closed forms start from."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from edtorch.models import Model
from edtorch.policies import LinearPolicy
from edtorch.types import Parameters


class LinearLoop(NamedTuple):
    """s' = (F + G theta) s: F ``[B, n, n]``, G ``[B, n, m]``, theta ``[B, m, n]``."""

    F: Tensor
    G: Tensor
    theta: Tensor


def linear_loop(
    model: Model,
    policy: LinearPolicy,
    model_parameters: Parameters,
    policy_parameters: Parameters,
    dt: float,
) -> LinearLoop:
    """The loop over ``dt`` seconds; ValueError if model or policy is not linear in the state."""
    dynamics = model.linear_dynamics(model_parameters["weight"], dt)
    theta = policy.linear_gain(policy_parameters["weight"])
    if dynamics is None or theta is None:
        raise ValueError("the closed loop is not linear in the state: no closed form")
    return LinearLoop(dynamics.state, dynamics.action, theta)
