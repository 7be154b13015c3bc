"""From the groups ``command``, ``schedule`` and ``observation`` to their parts."""

from __future__ import annotations

import math
from typing import Any

import torch

from edtorch.app.checks import at_least, check_component, positive
from edtorch.app.errors import ConfigError, under
from edtorch.learner.annealing import Annealed
from edtorch.learner.limit import CommandLimit, Ramp, Safe
from edtorch.learner.schedule import Schedule, schedule_for
from edtorch.model.models import Model
from edtorch.model.noise import Noise
from edtorch.policy.policies import Policy
from edtorch.run.scaled_sim import World
from sims.base import Spec


def variant(config: Any) -> str:
    """Of the group ``command``."""
    return config.variant


def needs_noise(config: Any) -> bool:
    """Whether the bound is made of a predicted covariance."""
    return variant(config) == "safe" and config.deviations > 0


def limits(spec: Spec) -> list[tuple[int, float]]:
    """The components of the state that have a limit, and that in scaled units."""
    return [(i, q.limit / q.scale) for i, q in enumerate(spec.state) if math.isfinite(q.limit)]


def action_bounds(spec: Spec) -> tuple[tuple[int, float], ...]:
    """The actions that are clipped, and how far from zero each may be in scaled units."""
    if not spec.clip_action:
        return ()
    bounds = ((i, min(-q.low, q.high) / q.scale) for i, q in enumerate(spec.action))
    return tuple((i, bound) for i, bound in bounds if math.isfinite(bound))


def _ramp(config: Any, world: World) -> Ramp:
    names = [q.name for q in world.spec.state]
    check_component("command.component", config.component, config.component, names)
    for key in ("start", "final", "decay"):
        positive(f"command.{key}", config[key])
    index = names.index(config.component)
    scale = world.spec.state[index].scale
    with under("command"):
        bound = Annealed(config.start / scale, config.final / scale, config.decay / world.dt)
        return Ramp(index, len(names), bound, world.dtype)


def build_command(
    config: Any, world: World, model: Model, policy: Policy, noise: Noise | None
) -> CommandLimit | None:
    """The rule for what is seen of an observation, from the group ``command``."""
    if variant(config) == "free":
        return None
    ramp = _ramp(config, world)
    if config.variant == "ramp":
        return ramp
    constrained = limits(world.spec)
    if not constrained:
        raise ConfigError(
            f"command=safe: expected a domain whose state has limits; {world.spec.name} has none"
        )
    with under("command"):
        share = Annealed(config.share_start, config.share, config.decay / world.dt)
        return Safe(
            ramp,
            model,
            policy,
            noise,
            config.dt,
            config.horizon,
            tuple(constrained),
            share,
            config.deviations,
            action_bounds(world.spec) if config.actions else (),
        )


def check_start(config: Any, world: World) -> None:
    """Refuse a learner that is beyond a limit before it has done anything."""
    if variant(config) != "safe":
        return
    # Both ends and the middle of what a start is drawn from.
    for share in (0.0, 0.5, 1.0 - 1e-9):
        uniform = torch.full((1, world.uniforms), share, dtype=world.dtype, device=world.device)
        observed = world.observe(world.initial(uniform))[0]
        for index, limit in limits(world.spec):
            if not abs(float(observed[index])) <= limit:
                quantity = world.spec.state[index]
                raise ConfigError(
                    f"command=safe: a start of {world.spec.name} has {quantity.name}="
                    f"{float(observed[index]) * quantity.scale:.4g} {quantity.unit}, expected at"
                    f" most its limit, {quantity.limit:.4g}; see domain.*"
                )


def build_schedule(config: Any, dt: float, unknowns: int) -> Schedule:
    """When the policy is improved, from the group ``schedule``; dt: seconds per tick; unknowns: in
    each equation of the model."""
    often = None
    if config.often is not None:
        at_least("schedule.often", config.often, 0)
        often = round(config.often / dt)
    with under("schedule"):
        return schedule_for(unknowns, config.first, often, config.every)


def build_exploration(config: Any, dt: float, unknowns: int) -> float | Annealed:
    """The standard deviation of the exploration, from the group ``exploration``; unknowns: in each
    equation of the model."""
    at_least("exploration.deviation", config.deviation, 0)
    if config.start is None:
        return config.deviation
    at_least("exploration.start", config.start, 0)
    if config.decay is None:
        return Annealed(config.start, config.deviation, 2.0 * unknowns)
    positive("exploration.decay", config.decay)
    return Annealed(config.start, config.deviation, config.decay / dt)
