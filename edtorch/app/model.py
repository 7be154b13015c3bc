"""From the groups ``model``, ``fit`` and ``noise`` to their parts."""

from __future__ import annotations

from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError
from edtorch.app.features import features_of
from edtorch.app.observation import build_deviations
from edtorch.learner.filter import JointFilter
from edtorch.model.fit import Fit
from edtorch.model.models import Model
from edtorch.model.noise import BayesianNoise, Noise
from edtorch.run.scaled_sim import World


def build_model(config: Any, world: World, dtype: torch.dtype, seed: int) -> Model:
    """The model, as a template for one learner.  Raises ConfigError."""
    states, actions = len(world.spec.state), len(world.spec.action)
    features, rest = features_of("model", config, states + actions, world.spec, seed)
    return construct(
        "model",
        rest,
        "linear_dynamics",
        states=states,
        actions=actions,
        features=features,
        period=world.period,
    )


def build_fit(config: DictConfig, world: World, model: Model) -> Fit | JointFilter:
    """The estimator of the model's parameters, from the group ``fit``."""
    deviations = build_deviations(config.observation, world)
    return construct("fit", config.fit, "initial", "update", model=model, deviations=deviations)


def build_noise(config: Any, fit: Fit | JointFilter, model: Model, stretch: float) -> Noise:
    """The rule for nu~; stretch: ticks of the simulator in a step of the unroll."""
    own = [str(k) for k in config if not str(k).startswith("exploration")]
    rest = OmegaConf.masked_copy(config, own)
    noise = construct("noise", rest, "covariance", "update", stretch=stretch)
    if isinstance(noise, BayesianNoise) and "P" not in fit.initial(model.weight):
        raise ConfigError(
            f"noise._target_={config._target_}: expected a fit that knows how sure it is, "
            "fit=least_squares or fit=bayesian"
        )
    return noise
