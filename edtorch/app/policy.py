"""From the group ``policy`` to a policy, and to all that acts by one."""

from __future__ import annotations

from typing import Any

import torch
from omegaconf import DictConfig

from edtorch.app.construct import construct
from edtorch.app.features import features_of
from edtorch.app.inverse import build_controller, has_inverse
from edtorch.app.limit import variant
from edtorch.app.model import build_fit, build_model
from edtorch.app.observation import build_observer
from edtorch.inverse.controller import InverseController
from edtorch.learner.observer import Observer
from edtorch.policy.policies import LinearPolicy
from edtorch.run.checkpoint import PolicyCard
from edtorch.run.scaled_sim import World
from sims.base import Sim

FeaturedActor = LinearPolicy | InverseController
Shapes = dict[str, tuple[int, ...]]


def build_policy(config: Any, sim: Sim, dtype: torch.dtype, seed: int) -> LinearPolicy:
    """The policy, as a template for one learner."""
    states, actions = len(sim.spec.state), len(sim.spec.action)
    features, rest = features_of("policy", config, states, sim.spec, seed)
    return construct(
        "policy",
        rest,
        "linear_gain",
        states=states,
        actions=actions,
        features=features,
        dtype=dtype,
    )


def build_frozen_observer(config: DictConfig, world: World) -> Observer | None:
    """What a frozen policy of this configuration estimates the state with."""
    if has_inverse(config):
        return None
    model = build_model(config.model, world, world.dtype, config.seed)
    return build_observer(config.observation, world, model, build_fit(config, world, model))


def build_actor(config: Any, world: World) -> tuple[FeaturedActor, Shapes]:
    """What acts, for one learner, and the shapes of its parameters."""
    sim, dtype = world.sim, world.dtype
    if has_inverse(config):
        controller = build_controller(config.inverse, sim)
        n = controller.policy.layout.joints
        shapes = {
            "weight": (n, controller.policy.outputs),
            "inverse": (n, controller.features.outputs),
        }
        return controller, shapes
    policy = build_policy(config.policy, sim, dtype, config.seed)
    shapes = {name: tuple(p.shape) for name, p in policy.named_parameters()}
    if variant(config.command) != "free":
        shapes["limit"] = (len(sim.spec.state),)
    observer = build_frozen_observer(config, world)
    if observer is not None:
        shapes["model"] = tuple(observer.model.weight.shape)
    return policy, shapes


def policy_card(sim: Sim, policy: FeaturedActor, seeds: list[int]) -> PolicyCard:
    """What a policy of this configuration is made for."""
    spec = sim.spec
    return PolicyCard(
        domain=spec.name,
        states=[q.name for q in spec.state],
        actions=[q.name for q in spec.action],
        scales=[q.scale for q in (*spec.state, *spec.action)],
        policy=f"{type(policy).__name__}({type(policy.features).__name__})",
        seeds=seeds,
    )
