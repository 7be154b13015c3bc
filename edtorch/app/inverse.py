"""From the configuration group ``inverse`` to a learner of inverse models."""

from __future__ import annotations

from typing import Any, get_args

import torch

from edtorch.app.checks import at_least
from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError, under
from edtorch.app.limit import variant
from edtorch.app.reward import QUADRATIC
from edtorch.app.settings import Settings
from edtorch.inverse.controller import InverseController
from edtorch.inverse.coordinates import Coordinates, JointCoordinates
from edtorch.inverse.features import INVERSE_FEATURES, InverseFeatures
from edtorch.inverse.generic import GenericInverse
from edtorch.inverse.hand import HandCoordinates
from edtorch.inverse.layout import Layout
from edtorch.inverse.learner import InverseLearner, SampleWeight
from edtorch.inverse.policy import InversePolicy
from edtorch.inverse.unroll import InverseUnroll, InverseValue
from edtorch.model.noise import Noise
from edtorch.value.choose import Method
from edtorch.value.unroll import Horizon
from sims.base import Jointed, Sim


def has_inverse(config: Any) -> bool:
    """Whether a configuration asks for an inverse model."""
    return config.inverse.variant != "none"


def _features(config: Any, layout: Layout) -> InverseFeatures:
    if isinstance(config, Settings):
        return construct("inverse.features", config, "__call__", layout=layout)
    if config not in INVERSE_FEATURES:
        raise ConfigError(
            f"inverse.features={config}: expected one of {', '.join(INVERSE_FEATURES)},"
            " or a mapping with a _target_"
        )
    with under("inverse.features"):
        return INVERSE_FEATURES[config](layout)


def _coordinates(config: Any, layout: Layout, sim: Sim) -> Coordinates:
    if config.variant == "learned":
        return JointCoordinates(layout)
    if not isinstance(sim, Jointed):
        raise ConfigError(
            f"inverse=kinematic: expected a domain with a chain of joints; {sim.spec.name} has none"
        )
    with under("inverse"):
        return HandCoordinates(
            layout, sim.chain(), length=config.length, damping=config.damping, bent=config.bent
        )


def build_controller(config: Any, sim: Sim) -> InverseController:
    """What acts, from the group ``inverse``."""
    try:
        layout = Layout(sim.spec)
    except ValueError as error:
        raise ConfigError(f"inverse={config.variant}: {error}") from error
    with under("inverse"):
        policy = InversePolicy(layout, config.gain, config.limit, config.form)
    features = _features(config.features, layout)
    return InverseController(policy, features, _coordinates(config, layout, sim))


def _value(config: Settings, policy: InversePolicy, horizon: Horizon) -> InverseValue:
    """The way to value and gradient: written out where it is, else torch's differentiation."""
    method, deviation = config.unroll.path, config.unroll.start_deviation
    if method not in get_args(Method):
        raise ConfigError(f"unroll.path={method}: expected one of {', '.join(get_args(Method))}")
    for key, only in (("start", "state"), ("direction", "gradient")):
        if config.unroll[key] != only:
            raise ConfigError(
                f"unroll.{key}={config.unroll[key]}: expected {only} with an inverse policy"
            )
    at_least("unroll.start_deviation", deviation, 0)
    transform = construct(
        "transform",
        config.transform,
        "move",
        "reward",
        "keeps_positive",
        states=policy.layout.size + policy.layout.joints,
        generator=torch.Generator().manual_seed(config.seed),
    )
    if deviation > 0 and not transform.propagates_covariance:
        raise ConfigError(
            f"unroll.start_deviation={deviation}: expected 0 with this transform, which leaves the"
            " covariance out; transform=first takes it in"
        )
    written_out = getattr(transform, "at_mean", False)
    if method == "closed_form" and not written_out:
        raise ConfigError(
            "unroll.path=closed_form: expected transform=mean_only or first with an inverse"
            f" policy, not {type(transform).__name__}"
        )
    with under("reward"):
        if written_out and method != "generic":
            covariance = transform.propagates_covariance
            return InverseUnroll(policy, horizon, config.reward.goal, covariance, deviation)
        return GenericInverse(policy, horizon, transform, config.reward.goal, deviation)


def _noise(config: Settings) -> Noise:
    noise = construct("noise", config, "covariance", "update", stretch=1.0)
    if not noise.is_constant:
        raise ConfigError(
            f"noise._target_={config._target_}: expected noise=residual with an inverse policy"
        )
    return noise


def build_inverse_learner(config: Settings, sim: Sim) -> InverseLearner:
    """The learner, from a whole configuration."""
    controller = build_controller(config.inverse, sim)
    if config.log.value_error:
        raise ConfigError("log.value_error=true: expected false with an inverse policy")
    for key, value in config.reward.items():
        if key != "goal" and value and value != QUADRATIC:
            raise ConfigError(
                f"reward.{key}={value}: expected nothing but reward.goal with an inverse policy"
            )
    with under("unroll"):
        unroll = config.unroll
        horizon = Horizon(unroll.horizon, unroll.dt, unroll.discount, unroll.dt, unroll.reading)
    value = _value(config, controller.policy, horizon)
    noise = _noise(config.noise) if value.propagates_covariance else None
    if variant(config.command) != "free":
        raise ConfigError(
            f"command={config.command.variant}: expected free with an inverse policy, whose error"
            " has a limit of its own (inverse.limit)"
        )
    at_least("exploration.deviation", config.exploration.deviation, 0)
    if config.exploration.start is not None:
        raise ConfigError(
            f"exploration.start={config.exploration.start}: expected null with an inverse policy"
        )
    fit = construct("fit", config.fit, "initial", "update")
    rule = construct("step", config.step, "initial")
    with under("inverse"):
        weight = SampleWeight(config.inverse.trust_acceleration, config.inverse.trust_speed)
        return InverseLearner(
            policy=controller,
            unroll=value,
            fit=fit,
            step_rule=rule,
            every=config.inverse.every,
            recent=config.inverse.recent,
            exploration=config.exploration.deviation,
            sample_weight=weight,
            noise=noise,
        )


def inverse_path(learner: InverseLearner) -> str:
    """How value and gradient are found, in words."""
    what = "with covariance" if learner.unroll.propagates_covariance else "mean only"
    how = "torch's differentiation" if learner.needs_autograd else "its adjoint written out"
    return f"inverse policy, {what}, {how}"
