"""From a composed configuration to objects.  Strings end here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from edtorch.app.budget import build_budget, check_ticks
from edtorch.app.checks import at_least, check_numbers, check_seeds, positive
from edtorch.app.compute import (
    check_kernels,
    check_memory,
    check_recording,
    device_of,
    refuse_kernels,
)
from edtorch.app.domain import build_sim, changed_domain
from edtorch.app.errors import ConfigError, under
from edtorch.app.forward import build_forward
from edtorch.app.inverse import build_inverse_learner, has_inverse, inverse_path
from edtorch.app.limit import build_schedule
from edtorch.app.observation import check_unobserved
from edtorch.app.policy import policy_card
from edtorch.app.reward import build_reward
from edtorch.app.settings import Settings
from edtorch.app.solved import build_solved_rate
from edtorch.learner.learner import AnyLearner
from edtorch.learner.schedule import Schedule
from edtorch.run.episodes import Budget
from edtorch.run.policy_file import PolicyCard
from edtorch.run.scaled_sim import World
from edtorch.value.error_estimate import ValueErrorIndicator
from sims.base import Sim


@dataclass(frozen=True)
class Setup:
    """Everything that a training run is made of.

    calm: a new world to evaluate in; schedule: when policies are improved; path: how value and
    gradient are found, in words.
    """

    learner: AnyLearner
    world: World
    calm: Callable[[], World]
    seeds: list[int]
    budget: Budget
    schedule: Schedule
    card: PolicyCard
    path: str
    indicator: ValueErrorIndicator | None


def _check(config: Settings) -> None:
    """Refuse keys and numbers that are wrong whatever is built of them."""
    check_numbers(config)
    check_seeds(config)
    at_least("eval.episodes", config.eval.episodes, int(build_solved_rate(config).asked))
    at_least("eval.keep", config.eval.keep, 0)
    for place, minutes in enumerate(config.eval.minutes):
        positive(f"eval.minutes[{place}]", minutes)
    at_least("compute.threads", config.compute.threads, 1)
    at_least("log.every", config.log.every, 1)


def build(config: Settings, budget: Budget | None = None) -> Setup:
    """Objects for ``edtorch-train``; budget: instead of that of the group ``train``.  Raises
    ConfigError, which names the key."""
    _check(config)
    budget = build_budget(config.train) if budget is None else budget
    if config.train.until is not None:
        raise ConfigError(
            f"train.until={config.train.until}: expected null without a rival; a learner has"
            " train.seconds, train.episodes or train.successes"
        )
    sim = build_sim(config.domain)
    check_ticks(budget, sim.spec.dt)
    if config.log.transitions:
        check_recording(budget, World(sim), config.seeds)
    device = device_of(config.compute)
    if has_inverse(config):
        refuse_kernels(config.compute, "an inverse model")
        if device.type != "cpu":
            raise ConfigError(
                f"compute.device={config.compute.device}: expected cpu with an inverse model"
            )
    setup = _assemble(config, sim, budget, device)
    if config.compute.native == "on":
        check_kernels(setup.learner, setup.world)
    return setup


def _assemble(config: Settings, sim: Sim, budget: Budget, device: torch.device) -> Setup:
    if config.eval.keep and not config.eval.episodes:
        raise ConfigError(f"eval.keep={config.eval.keep}: expected 0 with eval.episodes=0")
    unwrap = config.observation.unwrap
    reward = build_reward(config.reward, sim, torch.float64, device)
    threshold = config.eval.success_return
    with under("observation"):
        world = World(sim, torch.float64, device, unwrap, reward, threshold)
    evaluated = changed_domain(config.domain, config.eval.domain, "eval.domain")
    if config.eval.domain:
        build_sim(evaluated, "eval.domain")
    indicator = None
    unknowns = 1
    if has_inverse(config):
        check_unobserved(config.observation)
        learner = build_inverse_learner(config, sim)
        check_memory(learner, world, config.seeds)
        path = inverse_path(learner)
    else:
        forward = build_forward(config, world)
        learner, path = forward.learner, forward.path
        unknowns = forward.learner.model.regressors
        indicator = forward.indicator
    # Not before the population is known to fit in memory.
    seeds = list(range(config.seed, config.seed + config.seeds))
    card = policy_card(sim, learner.policy, seeds)

    def calm() -> World:
        sim = build_sim(evaluated)
        return World(sim, torch.float64, device, unwrap, reward, threshold)

    return Setup(
        learner,
        world,
        calm,
        seeds,
        budget,
        build_schedule(config.schedule, world.dt, unknowns),
        card,
        path,
        indicator,
    )
