"""Which way to the value and its gradient: the one place that decides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypedDict, cast

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
    mean_value_and_gradient,
    moment_value_and_gradient,
)
from edtorch.value.linear.ignorance import NoisePasses, at_mean, averaged
from edtorch.value.linear.loop import squared
from edtorch.value.linear.recursion import is_diagonal, mean_by_recursion, moment_by_recursion
from edtorch.value.unroll import Generic, Horizon, ValuePath

Method = Literal["auto", "closed_form", "generic"]

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
    linear = _ClosedForm(cast(GainedPolicy, policy), model, horizon, augmented)
    costs = _loop_costs(form, affine=affine)
    loop = "affine" if affine else "linear"
    start = model.period.new_zeros(model.states, model.states) if start_cov is None else start_cov
    if noise is None or not covariance:
        path, compiled, what = linear.mean_only(costs)
    elif noise.is_constant:
        path, compiled, what = linear.moment(costs, noise, start.detach())
    else:
        passes = at_mean if getattr(transform, "at_mean", False) else averaged
        rule = cast(QuadraticNoise, noise)
        path, compiled, what = linear.ignorance(costs, rule, start.detach(), passes)
    reason = f"closed form ({loop} closed loop, quadratic reward, {what})"
    return Choice(path, reason, generic, compiled)


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


@dataclass(frozen=True)
class _ClosedForm:
    """The closed forms of one closed loop: each a path, the same as a compiler wants it (None where
    there is no such form), and a word for what it propagates."""

    policy: GainedPolicy
    model: Model
    horizon: Horizon
    augmented: bool

    @property
    def _is_short(self) -> bool:
        return self.horizon.steps <= MOST_RECURSIVE_STEPS

    def _batched(self, costs: _Costs) -> dict[str, Any]:
        return {**costs, "weights": costs["state_cost"].new_tensor(self.horizon.weights())}

    def _stepwise(self, costs: _Costs) -> dict[str, Any] | None:
        """For the recursions, which know no cross terms."""
        if costs["cross"] is not None:
            return None
        cost = costs["state_cost"]
        return {
            "state_cost": cost.diagonal() if is_diagonal(cost) else cost,
            "action_cost": costs["action_cost"],
            "weights": self.horizon.weights(),
        }

    def mean_only(self, costs: _Costs) -> tuple[ValuePath, ValuePath | None, str]:
        """The mean alone."""
        solve = partial(mean_value_and_gradient, **self._batched(costs))
        path = LinearMeanOnly(self.model, self.policy, self.horizon.dt, solve, self.augmented)
        # Doubling is a short program for any horizon, if not the fastest.
        compiled, stepwise = path, self._stepwise(costs)
        if self._is_short and stepwise is not None:
            compiled = replace(path, solve=partial(mean_by_recursion, **stepwise))
        return path, compiled, "mean only"

    def moment(
        self, costs: _Costs, noise: Noise, start: Tensor
    ) -> tuple[ValuePath, ValuePath | None, str]:
        """Mean and covariance, constant noise."""
        solve = partial(moment_value_and_gradient, **self._batched(costs))
        path = LinearMoment(
            self.model, self.policy, self.horizon.dt, solve, noise, start, self.augmented
        )
        compiled, stepwise = None, self._stepwise(costs)
        if self._is_short and stepwise is not None:
            compiled = replace(path, solve=partial(moment_by_recursion, **stepwise))
        return path, compiled, "mean and covariance"

    def ignorance(
        self, costs: _Costs, noise: QuadraticNoise, start: Tensor, passes: NoisePasses
    ) -> tuple[ValuePath, ValuePath | None, str]:
        """Mean and covariance, noise that grows with what the model does not know."""
        path = LinearIgnorance(
            self.model,
            self.policy,
            self.horizon,
            noise,
            start,
            passes,
            **costs,
            augmented=self.augmented,
        )
        what = "mean, covariance and what the model does not know"
        return path, path if self._is_short else None, what
