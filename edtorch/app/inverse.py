"""From the configuration group ``inverse`` to a learner of inverse models."""

from __future__ import annotations

from typing import Any

import torch
from omegaconf import DictConfig

from edtorch.app.checks import at_least
from edtorch.app.command import variant
from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError, under
from edtorch.inverse.controller import InverseController
from edtorch.inverse.coordinates import Coordinates, JointCoordinates
from edtorch.inverse.features import FEATURES, InverseFeatures
from edtorch.inverse.hand import HandCoordinates
from edtorch.inverse.layout import Layout
from edtorch.inverse.learner import InverseLearner, Trust
from edtorch.inverse.policy import InversePolicy
from edtorch.inverse.unroll import InverseUnroll
from edtorch.unroll import Horizon
from sims.base import Jointed, Sim

VARIANTS = ("none", "learned", "kinematic")
MEAN_ONLY = "edtorch.transform.MeanOnly"


def has_inverse(config: Any) -> bool:
    """Whether a configuration asks for an inverse model."""
    if config.inverse is None:
        return False
    if config.inverse.variant not in VARIANTS:
        raise ConfigError(
            f"inverse.variant={config.inverse.variant}: expected one of {', '.join(VARIANTS)}"
        )
    return config.inverse.variant != "none"


def _features(config: Any, layout: Layout) -> InverseFeatures:
    if isinstance(config, DictConfig):
        return construct("inverse.features", config, "__call__", layout=layout)
    if config not in FEATURES:
        raise ConfigError(
            f"inverse.features={config}: expected one of {', '.join(FEATURES)},"
            " or a mapping with a _target_"
        )
    with under("inverse.features"):
        return FEATURES[config](layout)


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


def build_inverse_learner(config: DictConfig, sim: Sim, dtype: torch.dtype) -> InverseLearner:
    """The learner, from a whole configuration."""
    controller = build_controller(config.inverse, sim)
    if dtype != torch.float64:
        raise ConfigError(
            f"compute.precision={config.compute.precision}: expected float64 with an inverse model,"
            " whose sums of products span decades"
        )
    if config.transform.get("_target_") != MEAN_ONLY:
        raise ConfigError(
            f"transform._target_={config.transform.get('_target_')}: expected {MEAN_ONLY} with an"
            " inverse policy"
        )
    if config.log.value_error:
        raise ConfigError("log.value_error=true: expected false with an inverse policy")
    for key in ("state", "action"):
        if config.reward[key]:
            raise ConfigError(
                f"reward.{key}={dict(config.reward[key])}: expected nothing but reward.goal with an"
                " inverse policy"
            )
    with under("unroll"):
        unroll = config.unroll
        horizon = Horizon(unroll.horizon, unroll.dt, unroll.discount, unroll.dt, unroll.reading)
    with under("reward"):
        value = InverseUnroll(controller.policy, horizon, config.reward.goal)
    if variant(config.command) != "free":
        raise ConfigError(
            f"command={config.command.variant}: expected free with an inverse policy, whose error"
            " has a limit of its own (inverse.limit)"
        )
    at_least("noise.exploration", config.noise.exploration, 0)
    fit = construct("fit", config.fit, "initial", "update")
    rule = construct("step", config.step, "initial")
    with under("inverse"):
        trust = Trust(config.inverse.trust_acceleration, config.inverse.trust_speed)
        return InverseLearner(
            policy=controller,
            unroll=value,
            fit=fit,
            step_rule=rule,
            every=config.inverse.every,
            recent=config.inverse.recent,
            exploration=config.noise.exploration,
            trust=trust,
        )
