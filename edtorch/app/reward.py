"""From the group ``reward`` to a reward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from edtorch.app.checks import at_least
from edtorch.app.errors import ConfigError
from edtorch.inverse.forward import distance_cost
from edtorch.rewards import QuadraticReward
from sims.base import Quantity, Sim, Spec


def _weights(key: str, config: Mapping[str, float], quantities: tuple[Quantity, ...]) -> Tensor:
    """Diagonal cost in scaled units from weights in physical ones, by name."""
    names = [q.name for q in quantities]
    for name, weight in config.items():
        if name not in names:
            raise ConfigError(f"{key}.{name}={weight}: expected one of {', '.join(names)}")
        at_least(f"{key}.{name}", weight, 0)
    return torch.diag(
        torch.tensor(
            [config.get(q.name, 0.0) * q.scale**2 for q in quantities], dtype=torch.float64
        )
    )


def _distance(weight: float, spec: Spec) -> Tensor:
    """Cost of the squared distance of the tracked components from their goal, scaled units."""
    if weight > 0 and not spec.goal:
        raise ConfigError(f"reward.goal={weight}: expected a domain with a goal, not {spec.name}")
    return weight * distance_cost(spec)


def build_reward(
    config: Any, sim: Sim, dtype: torch.dtype, device: torch.device | None = None
) -> QuadraticReward:
    """The shaping reward, in scaled units."""
    at_least("reward.goal", config.goal, 0)
    if not (config.goal > 0 or any(weight > 0 for weight in config.state.values())):
        names = ", ".join(q.name for q in sim.spec.state)
        raise ConfigError(
            f"reward.state={dict(config.state)}: expected a weight > 0 for one of {names}"
        )
    state = _weights("reward.state", config.state, sim.spec.state)
    state = state + _distance(config.goal, sim.spec)
    action = _weights("reward.action", config.action, sim.spec.action)
    return QuadraticReward(state.to(device, dtype), action.to(device, dtype))
