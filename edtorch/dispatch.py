"""Which way to the value and its gradient: the one place that decides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch

from edtorch.closed_form import LinearMeanOnly
from edtorch.models import Model
from edtorch.policies import LinearPolicy
from edtorch.rewards import QuadraticReward, Reward
from edtorch.transform import Transform
from edtorch.unroll import Generic, Horizon, ValuePath

Wish = Literal["auto", "closed_form", "generic"]


@dataclass(frozen=True)
class Choice:
    """The path taken and a sentence for the log that says why."""

    path: ValuePath
    reason: str


def choose_path(
    wish: Wish,
    model: Model,
    policy: LinearPolicy,
    reward: Reward,
    transform: Transform,
    horizon: Horizon,
) -> Choice:
    """The closed form where the closed loop allows it, the generic path elsewhere.

    wish: ``auto``, or one of the two by name; ValueError if ``closed_form`` is asked for and some
    part does not allow it.
    """
    obstacles = []
    if model.linear_dynamics(model.weight.detach(), horizon.dt) is None:
        obstacles.append("the model is not linear in state and action")
    if policy.linear_gain(policy.weight.detach()) is None:
        obstacles.append("the policy is not linear in the state")
    if not isinstance(reward, QuadraticReward):
        obstacles.append("the reward is not quadratic")
    if transform.propagates_covariance:
        obstacles.append("the transform propagates the covariance")
    if horizon.first_step == 0:
        obstacles.append("the value counts the reward of the present state")
    if wish == "closed_form" and obstacles:
        raise ValueError(f"no closed form: {'; '.join(obstacles)}")
    if wish == "generic" or obstacles or not isinstance(reward, QuadraticReward):
        because = "; ".join(obstacles) or "asked for"
        generic = Generic(model, policy, reward, transform, horizon)
        return Choice(generic, f"generic path ({because})")
    weights = torch.tensor(horizon.weights(), dtype=model.weight.dtype, device=model.weight.device)
    closed = LinearMeanOnly(model, policy, reward, horizon, weights)
    return Choice(closed, "closed form (linear closed loop, quadratic reward, mean only)")
