"""The policies that a finished run left, ready to act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from edtorch.app.build_planned import build_problem, is_planned
from edtorch.app.domain import build_sim, changed_domain
from edtorch.app.errors import ConfigError, under
from edtorch.app.policy import build_actor, build_frozen_observer, policy_card
from edtorch.app.random_search import is_rival, is_search
from edtorch.app.reward import build_reward
from edtorch.app.rivals import build_rival, rival_card
from edtorch.app.settings import Settings
from edtorch.learner.learner import Actor
from edtorch.policy.memory import EpisodeMemory
from edtorch.rivals.base import Storing
from edtorch.run.files import FileProblem
from edtorch.run.policy_file import load_policy, policy_dtype, saved_seeds
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters


@dataclass(frozen=True)
class Policies:
    """parameters: ``[S, ...]``, a policy per seed, or per number of a search; observer: what they
    estimate the state with, None if they take what they observe for it."""

    actor: Actor
    parameters: Parameters
    seeds: list[int]
    observer: EpisodeMemory | None = None


def acting_dtype(config: Settings, path: Path) -> torch.dtype:
    """The number type of the world in which the policies of the file ``path`` act."""
    if is_rival(config) and not is_search(config):
        # Networks have a type of their own.
        return torch.float64
    return policy_dtype(path)


def frozen_world(config: Settings, path: Path, changes: Mapping[str, Any] | None = None) -> World:
    """A world for the policies in the file ``path`` of a run with this configuration; changes: of
    its domain.  Raises ConfigError, and FileProblem for the file."""
    sim = build_sim(changed_domain(config.domain, changes or {}, "domain"))
    dtype = acting_dtype(config, path)
    # Only a search among random policies knows no reward.
    searched = is_rival(config) and is_search(config)
    return World(
        sim,
        dtype,
        unwrap=config.observation.unwrap,
        reward=None if searched else build_reward(config.reward, sim, dtype),
        success_return=config.eval.success_return,
    )


def stored_policies(config: Settings, path: Path, world: World) -> Policies:
    """Those in the file ``path`` of a run with this configuration, for a world of its domain.

    Raises ConfigError, and FileProblem for the file.
    """
    if is_rival(config) and not is_search(config):
        return _of_rival(config, path, world)
    if is_planned(config):
        return _of_search(config, path, world)
    actor, shapes = build_actor(config, world)
    # A search has one seed and any number of policies, which have numbers instead.
    one_each = not is_rival(config)
    seeds = [config.seed + k for k in range(config.seeds)] if one_each else saved_seeds(path)
    if not seeds:
        raise FileProblem(f"{path}: holds no policy; none of the search reached the goal")
    card = policy_card(world.sim, actor, seeds)
    observer = build_frozen_observer(config, world)
    return Policies(actor, load_policy(path, card, shapes), seeds, observer)


def _of_search(config: Settings, path: Path, world: World) -> Policies:
    """Of a search between trials."""
    search, problem = build_problem(config, world)
    actor, memory = search.actor(problem)
    seeds = [config.seed + k for k in range(config.seeds)]
    shapes = {name: tuple(p.shape[1:]) for name, p in actor.initial([0]).items()}
    card = policy_card(world.sim, actor, seeds)
    return Policies(actor, load_policy(path, card, shapes), seeds, memory)


def _of_rival(config: Settings, path: Path, world: World) -> Policies:
    """A search that has only begun has policies of the right shapes, and who acts by them."""
    setup = build_rival(config)
    with under("rival"):
        search = setup.rival.begin(setup.problem)
    if isinstance(search, Storing):
        raise ConfigError(
            f"rival={setup.name}: expected policies that are tensors of the same shape for every"
            f" seed; what {path.name} holds of this one cannot be tried again"
        )
    shapes = {name: tuple(p.shape[1:]) for name, p in search.parameters.items()}
    parameters = load_policy(path, rival_card(setup, search, world.spec), shapes)
    return Policies(search.actor, parameters, setup.seeds)
