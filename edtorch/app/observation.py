"""From the group ``observation`` to what a learner makes of its observations."""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import Tensor

from edtorch.app.checks import at_least, check_component
from edtorch.app.errors import ConfigError, under
from edtorch.learner.delay import Delay
from edtorch.learner.estimator import AnyFit
from edtorch.learner.filter import JointFilter
from edtorch.learner.observer import Observer
from edtorch.model.models import DerivativeModel, Model, NextStateModel
from edtorch.run.scaled_sim import World


def build_deviations(config: Any, world: World) -> Tensor:
    """Standard deviations ``[n]`` of what is observed, scaled, from ``observation.noise``."""
    quantities = {q.name: q for q in world.spec.state}
    for name, deviation in config.noise.items():
        key = f"observation.noise.{name}"
        check_component(key, deviation, name, quantities)
        at_least(key, deviation, 0)
    deviations = [config.noise.get(name, 0.0) / q.scale for name, q in quantities.items()]
    return torch.tensor(deviations, dtype=world.dtype, device=world.device)


def build_observer(config: Any, world: World, model: Model, fit: AnyFit) -> Observer | None:
    """From the group ``observation``; None where observations are taken for the state."""
    filtered = getattr(fit, "estimates_state", False)
    if config.noise and not filtered:
        raise ConfigError(
            f"observation.noise={dict(config.noise)}: expected fit=filtered, which makes use of it"
        )
    at_least("observation.delay", config.delay, 0)
    if not (filtered or config.delay):
        return None
    with under("observation"):
        # The observer refuses what is not linear in features.
        return Observer(
            cast(DerivativeModel | NextStateModel, model),
            Delay(config.delay),
            cast(JointFilter, fit) if filtered else None,
            world.seconds,
        )


def check_unobserved(config: Any) -> None:
    """Refuse what a learner of an inverse model makes no use of."""
    if config.delay or config.noise:
        name, value = ("delay", config.delay) if config.delay else ("noise", dict(config.noise))
        raise ConfigError(
            f"observation.{name}={value}: expected none with an inverse model, which takes"
            " observations for the state"
        )
