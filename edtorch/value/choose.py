"""Which way to the value and its gradient: the one place that decides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import torch
from torch import Tensor

from edtorch.model.models import Model
from edtorch.model.noise import BayesianNoise, Noise
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward, Reward
from edtorch.transform import Cubature, FirstOrder, MeanOnly, SecondOrder, Transform
from edtorch.value.linear import (
    LinearIgnorance,
    LinearMeanOnly,
    LinearMoment,
    mean_value_and_gradient,
    moment_value_and_gradient,
)
from edtorch.value.linear.ignorance import at_mean, averaged
from edtorch.value.linear.loop import squared
from edtorch.value.linear.recursion import is_diagonal, mean_by_recursion, moment_by_recursion
from edtorch.value.unroll import Generic, Horizon, ValuePath

Method = Literal["auto", "closed_form", "generic"]

EXACT_FOR_LINEAR = (MeanOnly, FirstOrder, SecondOrder, Cubature)
"""Transforms that are exact, hence equal, where the closed loop is linear."""


MOST_RECURSIVE_STEPS = 64
"""Longest horizon that is compiled step by step: every step is code of its own."""


@dataclass(frozen=True)
class Choice:
    """The path taken, a sentence for the log that says why, and its two companions.

    generic: the path that holds for everything; compiled: the same as ``path`` as a compiler wants
    it, None where there is no such form.
    """

    path: ValuePath
    reason: str
    generic: Generic
    compiled: ValuePath | None = None


def choose_path(
    method: Method,
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

    method: ``auto``, or one of the two by name; ValueError if ``closed_form`` is asked for and some
    part does not allow it.  noise: the rule for nu~, None for zero; start_cov ``[n, n]``: that of
    the belief that an unroll starts from, None for a point.
    """
    generic = Generic(model, policy, reward, transform, horizon, noise, start_cov)
    dynamics = model.linear_dynamics(model.weight.detach(), horizon.dt)
    gain = policy.linear_gain(policy.weight.detach())
    obstacles = []
    if dynamics is None:
        obstacles.append("the model is not linear in state and action")
    if gain is None:
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
    if method == "closed_form" and obstacles:
        raise ValueError(f"no closed form: {'; '.join(obstacles)}")
    if method == "generic" or obstacles or not isinstance(reward, QuadraticReward):
        because = "; ".join(obstacles) or "asked for"
        return Choice(generic, f"generic path ({because})", generic)

    affine = (dynamics is not None and dynamics.constant is not None) or (
        gain is not None and gain.constant is not None
    )
    cost = squared(reward.state_cost) if affine else reward.state_cost
    costs = {
        "state_cost": cost,
        "action_cost": reward.action_cost if reward.costs_actions else None,
    }
    stepwise = costs | {
        "state_cost": cost.diagonal() if is_diagonal(cost) else cost,
        "weights": horizon.weights(),
    }
    weights = torch.tensor(horizon.weights(), dtype=cost.dtype, device=cost.device)
    batched = costs | {"weights": weights}
    is_short = horizon.steps <= MOST_RECURSIVE_STEPS
    loop = "affine" if affine else "linear"
    what = "mean only"
    if noise is None or not transform.propagates_covariance:
        path = LinearMeanOnly(
            model, policy, horizon.dt, partial(mean_value_and_gradient, **batched)
        )
        # Doubling is a short program for any horizon, if not the fastest.
        compiled = path
        if is_short:
            compiled = replace(path, solve=partial(mean_by_recursion, **stepwise))
    else:
        cov = model.weight.new_zeros(model.states, model.states) if start_cov is None else start_cov
        cov = cov.detach()
        if isinstance(noise, BayesianNoise):
            what = "mean, covariance and what the model does not know"
            passes = at_mean if isinstance(transform, FirstOrder) else averaged
            path = LinearIgnorance(model, policy, reward, horizon, noise, cov, passes)
            compiled = path if is_short else None
        else:
            what = "mean and covariance"
            solve = partial(moment_value_and_gradient, **batched)
            path = LinearMoment(model, policy, horizon.dt, solve, noise, cov)
            by_steps = partial(moment_by_recursion, **stepwise)
            compiled = replace(path, solve=by_steps) if is_short else None
    reason = f"closed form ({loop} closed loop, quadratic reward, {what})"
    return Choice(path, reason, generic, compiled)
