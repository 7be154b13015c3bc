"""Which way to the value and its gradient: the one place that decides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from edtorch.closed_form import LinearIgnorance, LinearMeanOnly, LinearMoment
from edtorch.closed_form.ignorance import at_mean, averaged
from edtorch.models import Model
from edtorch.noise import BayesianNoise, Noise
from edtorch.policies import LinearPolicy
from edtorch.rewards import QuadraticReward, Reward
from edtorch.transform import Cubature, FirstOrder, MeanOnly, SecondOrder, Transform
from edtorch.unroll import Generic, Horizon, ValuePath

Wish = Literal["auto", "closed_form", "generic"]

EXACT_FOR_LINEAR = (MeanOnly, FirstOrder, SecondOrder, Cubature)
"""Transforms that are exact, hence equal, where the closed loop is linear."""


@dataclass(frozen=True)
class Choice:
    """The path taken, a sentence for the log that says why, and the generic path beside it."""

    path: ValuePath
    reason: str
    generic: Generic


def choose_path(
    wish: Wish,
    model: Model,
    policy: LinearPolicy,
    reward: Reward,
    transform: Transform,
    horizon: Horizon,
    *,
    noise: Noise | None = None,
    start_cov: Tensor | None = None,
) -> Choice:
    """The closed form where the closed loop allows it, the generic path elsewhere.

    wish: ``auto``, or one of the two by name; ValueError if ``closed_form`` is asked for and some
    part does not allow it.  noise: the rule for nu~, None for zero; start_cov ``[n, n]``: that of
    the belief that an unroll starts from, None for a point.
    """
    generic = Generic(model, policy, reward, transform, horizon, noise, start_cov)
    obstacles = []
    if model.linear_dynamics(model.weight.detach(), horizon.dt) is None:
        obstacles.append("the model is not linear in state and action")
    if policy.linear_gain(policy.weight.detach()) is None:
        obstacles.append("the policy is not linear in the state")
    if not isinstance(reward, QuadraticReward):
        obstacles.append("the reward is not quadratic")
    if not isinstance(transform, EXACT_FOR_LINEAR):
        obstacles.append("the transform is not known to be exact for linear loops")
    known = noise is not None and (noise.is_constant or isinstance(noise, BayesianNoise))
    if transform.propagates_covariance and not known:
        obstacles.append("the noise is neither constant nor Bayesian")
    if horizon.first_step == 0:
        obstacles.append("the value counts the reward of the present state")
    if wish == "closed_form" and obstacles:
        raise ValueError(f"no closed form: {'; '.join(obstacles)}")
    if wish == "generic" or obstacles or not isinstance(reward, QuadraticReward):
        because = "; ".join(obstacles) or "asked for"
        return Choice(generic, f"generic path ({because})", generic)
    weights = torch.tensor(horizon.weights(), dtype=model.weight.dtype, device=model.weight.device)
    if noise is None or not transform.propagates_covariance:
        mean = LinearMeanOnly(model, policy, reward, horizon, weights)
        reason = "closed form (linear closed loop, quadratic reward, mean only)"
        return Choice(mean, reason, generic)
    n = model.states
    cov = model.weight.new_zeros(n, n) if start_cov is None else start_cov
    what = "mean and covariance"
    path: ValuePath = LinearMoment(model, policy, reward, horizon, weights, noise, cov.detach())
    if isinstance(noise, BayesianNoise):
        passes = at_mean if isinstance(transform, FirstOrder) else averaged
        path = LinearIgnorance(model, policy, reward, horizon, noise, cov.detach(), passes)
        what = "mean, covariance and what the model does not know"
    return Choice(path, f"closed form (linear closed loop, quadratic reward, {what})", generic)
