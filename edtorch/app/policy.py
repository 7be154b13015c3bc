"""From the group ``policy`` to a policy, and to all that acts by one."""

from __future__ import annotations

from typing import Any, cast

import torch

from edtorch.app.construct import accepts, construct, given_part, is_given, target_class
from edtorch.app.errors import ConfigError
from edtorch.app.features import features_of, without_features
from edtorch.app.inverse import build_controller, has_inverse
from edtorch.app.limit import variant
from edtorch.app.model import build_fit, build_model
from edtorch.app.observation import build_observer
from edtorch.app.settings import Settings
from edtorch.learner.learner import Actor
from edtorch.learner.observer import Observer
from edtorch.policy.module import as_policy
from edtorch.policy.policies import LinearPolicy, Policy, policy_label
from edtorch.run.policy_file import PolicyCard
from edtorch.run.scaled_sim import World
from sims.base import Sim

Shapes = dict[str, tuple[int, ...]]


def build_policy(config: Any, sim: Sim, dtype: torch.dtype, seed: int) -> Policy:
    """The policy, as a template for one learner.

    A constructor gets what it asks for of ``states`` n, ``actions`` m, ``features`` (from
    ``policy.features``), ``spec``, ``dtype`` and ``middle`` (of the range of each action, scaled);
    a module without ``action`` is taken for a
    function from states to actions.  Raises ConfigError.
    """
    n, m = len(sim.spec.state), len(sim.spec.action)
    more: dict[str, Any] = {
        "states": n,
        "actions": m,
        "spec": sim.spec,
        "dtype": dtype,
        "middle": World(sim, dtype).action_middle,
    }
    if is_given(config):
        part = given_part("policy", config)
    elif accepts(target_class("policy", config), "features"):
        more["features"], rest = features_of("policy", config, n, sim.spec, seed)
        part = construct("policy", rest, **more)
    else:
        part = construct("policy", without_features("policy", config), **more)
    try:
        return as_policy(part, n, m, dtype)
    except (ValueError, TypeError, RuntimeError) as error:
        why = " ".join(str(error).split())
        raise ConfigError(f"{_called(config)}: {why}") from error


def _called(config: Settings) -> str:
    return "policy" if is_given(config) else f"policy._target_={config._target_}"


def build_linear_policy(config: Any, sim: Sim, dtype: torch.dtype, seed: int) -> LinearPolicy:
    """``build_policy`` for what searches among policies linear in features.  Raises ConfigError."""
    policy = build_policy(config, sim, dtype, seed)
    if not getattr(policy, "linear_in_features", False):
        raise ConfigError(
            f"{_called(config)}: expected a policy linear in features with a rival,"
            " policy=linear or squashed"
        )
    return cast(LinearPolicy, policy)


def build_frozen_observer(config: Settings, world: World) -> Observer | None:
    """What a frozen policy of this configuration estimates the state with."""
    if has_inverse(config):
        return None
    model = build_model(config.model, world, world.dtype, config.seed)
    return build_observer(config.observation, world, model, build_fit(config, world, model))


def build_actor(config: Any, world: World) -> tuple[Actor, Shapes]:
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
    shapes = {name: tuple(p.shape[1:]) for name, p in policy.initial([0]).items()}
    if variant(config.command) != "free":
        shapes["limit"] = (len(sim.spec.state),)
    observer = build_frozen_observer(config, world)
    if observer is not None:
        shapes["model"] = tuple(observer.model.weight.shape)
    return policy, shapes


def policy_card(sim: Sim, policy: Actor, seeds: list[int]) -> PolicyCard:
    """What a policy of this configuration is made for."""
    spec = sim.spec
    return PolicyCard(
        domain=spec.name,
        states=[q.name for q in spec.state],
        actions=[q.name for q in spec.action],
        scales=[q.scale for q in (*spec.state, *spec.action)],
        policy=policy_label(policy),
        seeds=seeds,
    )
