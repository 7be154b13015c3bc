"""Which way to the value and its gradient: the one place that decides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypedDict, cast

from torch import Tensor

from edtorch.model.models import Model, dynamics_of
from edtorch.model.noise import Noise, QuadraticNoise
from edtorch.policy.policies import GainedPolicy, Policy, gain_of
from edtorch.rewards import QuadraticForm, Reward, quadratic_form_of
from edtorch.transform import Transform
from edtorch.value.linear import (
    LinearIgnorance,
    LinearMeanOnly,
    LinearMoment,
)
from edtorch.value.linear.ignorance import at_mean, averaged
from edtorch.value.linear.loop import squared
from edtorch.value.unroll import Generic, Horizon, ValuePath

Method = Literal["auto", "closed_form", "generic"]


@dataclass(frozen=True)
class Choice:
    """The path taken, a sentence for the log that says why, and the path that holds for
    everything."""

    path: ValuePath
    reason: str
    generic: Generic


def choose_path(
    method: Method,
    model: Model,
    policy: Policy,
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
    dynamics = dynamics_of(model, model.initial([0]), horizon.dt)
    gain = gain_of(policy, policy.initial([0]))
    form = quadratic_form_of(reward)
    covariance = transform.propagates_covariance
    obstacles = []
    if dynamics is None:
        obstacles.append("the model is not linear in state and action")
    if gain is None:
        obstacles.append("the policy is not linear in the state")
    if form is None:
        obstacles.append("the reward is not quadratic")
    if not getattr(transform, "exact_for_linear", False):
        obstacles.append("the transform is not known to be exact for linear loops")
    if covariance and not (
        noise is not None and (noise.is_constant or getattr(noise, "is_quadratic", False))
    ):
        obstacles.append("the noise is neither constant nor Bayesian")
    if horizon.first_step == 0:
        obstacles.append("the value counts the reward of the present state")
    if method == "closed_form" and obstacles:
        raise ValueError(f"no closed form: {'; '.join(obstacles)}")
    if method == "generic" or dynamics is None or gain is None or form is None or obstacles:
        because = "; ".join(obstacles) or "asked for"
        return Choice(generic, f"generic path ({because})", generic)

    augmented = not form.is_homogeneous
    affine = augmented or dynamics.constant is not None or gain.constant is not None
    costs = _loop_costs(form, affine=affine)
    loop = "affine" if affine else "linear"
    start = model.period.new_zeros(model.states, model.states) if start_cov is None else start_cov
    gained, start = cast(GainedPolicy, policy), start.detach()
    if noise is None or not covariance:
        weights = costs["state_cost"].new_tensor(horizon.weights())
        path = LinearMeanOnly(
            model, gained, horizon.dt, weights=weights, augmented=augmented, **costs
        )
        what = "mean only"
    elif noise.is_constant:
        weights = costs["state_cost"].new_tensor(horizon.weights())
        path = LinearMoment(
            model, gained, horizon.dt, noise, start, weights=weights, augmented=augmented, **costs
        )
        what = "mean and covariance"
    else:
        passes = at_mean if getattr(transform, "at_mean", False) else averaged
        rule = cast(QuadraticNoise, noise)
        path = LinearIgnorance(
            model, gained, horizon, rule, start, passes, augmented=augmented, **costs
        )
        what = "mean, covariance and what the model does not know"
    return Choice(path, f"closed form ({loop} closed loop, quadratic reward, {what})", generic)


class _Costs(TypedDict):
    """Of (1, state) or the state, see ``edtorch.value.linear.loop.loop_cost``."""

    state_cost: Tensor
    action_cost: Tensor | None
    cross: Tensor | None


def _loop_costs(form: QuadraticForm, *, affine: bool) -> _Costs:
    state = squared(form.state) if affine else form.state
    cross = form.of_both if affine else form.cross
    return _Costs(
        state_cost=state if form.is_homogeneous else form.of_state,
        action_cost=form.action if bool((form.action != 0).any()) else None,
        cross=cross if bool((cross != 0).any()) else None,
    )
