"""From the groups ``model``, ``fit`` and ``noise`` to their parts."""

from __future__ import annotations

from typing import Any

import torch

from edtorch.app.construct import accepts, construct, target_class
from edtorch.app.errors import ConfigError
from edtorch.app.features import features_of, without_features
from edtorch.app.observation import build_deviations
from edtorch.app.reward import held
from edtorch.app.settings import Settings
from edtorch.learner.estimator import AnyFit
from edtorch.model.models import Model
from edtorch.model.module import as_model
from edtorch.model.noise import Noise
from edtorch.run.scaled_sim import World


def build_model(config: Any, world: World, dtype: torch.dtype, seed: int) -> Model:
    """The model, as a template for one learner.

    A constructor gets what it asks for of ``states`` n, ``actions`` m, ``features`` (from
    ``model.features``), ``period``, ``spec`` and ``dtype``; a module without ``next`` is taken for
    a function of state and action.  Raises ConfigError.
    """
    n, m = len(world.spec.state), len(world.spec.action)
    more: dict[str, Any] = {
        "states": n,
        "actions": m,
        "period": world.period,
        "spec": world.spec,
        "dtype": dtype,
    }
    if hasattr(target_class("model", config), "structures"):
        raise ConfigError(
            f"model._target_={config._target_}: expected search=planned, or model=derivative or"
            " next_state for a learner that improves its policy while it acts"
        )
    if accepts(target_class("model", config), "features"):
        more["features"], rest = features_of("model", config, n + m, world.spec, seed)
    else:
        rest = without_features("model", config)
    part = construct("model", rest, **more)
    try:
        return as_model(part, n, m, world.period)
    except (ValueError, TypeError, RuntimeError) as error:
        why = " ".join(str(error).split())
        raise ConfigError(f"model._target_={config._target_}: {why}") from error


FITS = (("initial", "update"), ("initial_memory", "improve"))
"""What a rule for weights offers, and one for any parameters."""


def build_fit(config: Settings, world: World, model: Model) -> AnyFit:
    """The estimator of the model's parameters, from the group ``fit``."""
    deviations = build_deviations(config.observation, world)
    offered = target_class("fit", config.fit)
    if hasattr(offered, "learn"):
        raise ConfigError(f"fit._target_={config.fit._target_}: expected search=planned")
    methods = FITS[1] if getattr(offered, "fits_parameters", False) else FITS[0]
    more: dict[str, Any] = {"model": model, "deviations": deviations, "states": model.states}
    if accepts(offered, "target"):
        more["target"] = held(config.reward, world.spec)
    fit = construct("fit", config.fit, *methods, **more)
    fits_weights = not (
        getattr(fit, "fits_parameters", False) or getattr(model, "linear_in_parameters", False)
    )
    if fits_weights:
        raise ConfigError(
            f"fit._target_={config.fit._target_}: expected fit=gradient with"
            f" model._target_={config.model._target_}, which is not linear in features"
        )
    if getattr(fit, "reads_state", False):
        _check_leading(config, model, len(world.spec.state), len(world.spec.action))
    return fit


def _check_leading(config: Settings, model: Model, n: int, m: int) -> None:
    """Refuse features that do not begin with 1 and the state, for a fit that finds it there."""
    state, action = (torch.linspace(0.1, 0.7, size, dtype=model.period.dtype) for size in (n, m))
    phi = model.phi(state, action)
    if not torch.equal(phi[: n + 1], torch.cat([torch.ones_like(phi[:1]), state])):
        given = config.model.get("features", "identity")
        raise ConfigError(
            f"model.features={given}: expected features that begin with 1 and the state, affine or"
            f" pairwise, with fit._target_={config.fit._target_}"
        )


def build_noise(config: Any, fit: AnyFit, model: Model, stretch: float) -> Noise:
    """The rule for nu~; stretch: ticks of the simulator in a step of the unroll."""
    noise = construct("noise", config, "covariance", "update", stretch=stretch)
    needs = getattr(noise, "needs", ())
    kept = getattr(fit, "initial", None)
    known = kept(model.initial([0])["weight"]) if needs and kept is not None else {}
    if any(name not in known for name in needs):
        raise ConfigError(
            f"noise._target_={config._target_}: expected a fit that knows how sure it is, "
            "fit=least_squares or fit=bayesian"
        )
    return noise
