"""From a whole configuration to a learner with a forward model."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeVar, cast, get_args

import torch

from edtorch.app.checks import at_least
from edtorch.app.compute import check_memory
from edtorch.app.construct import construct, known_keys
from edtorch.app.errors import ConfigError, under
from edtorch.app.limit import build_command, build_exploration, check_start, needs_noise
from edtorch.app.model import build_fit, build_model, build_noise
from edtorch.app.observation import build_observer
from edtorch.app.policy import build_policy
from edtorch.app.reward import build_reward, held, is_named, refuse_timed
from edtorch.app.settings import Settings
from edtorch.inverse.forward import tracking
from edtorch.learner.estimator import AnyFit
from edtorch.learner.learner import Learner
from edtorch.model.models import Model
from edtorch.policy.policies import GainedPolicy, Policy, gain_of
from edtorch.rewards import Reward, quadratic_form_of, target_of
from edtorch.run.scaled_sim import World
from edtorch.value.choose import Method, choose_path
from edtorch.value.error_estimate import ValueErrorIndicator
from edtorch.value.linear.equilibrium import EquilibriumRegulator, HoldSettings
from edtorch.value.linear.regulator import Regulator
from edtorch.value.unroll import FromOrigin, Horizon

STARTS = ("state", "origin")
DIRECTIONS = ("gradient", "regulator", "equilibrium")


@dataclass(frozen=True)
class Forward:
    """A learner with a forward model; path, indicator: as in ``Setup``."""

    learner: Learner
    path: str
    indicator: ValueErrorIndicator | None


_Part = TypeVar("_Part")


def _moved(part: _Part, device: torch.device) -> _Part:
    """A part with parameters on the device; one without ``to`` is none of torch's modules."""
    move = getattr(part, "to", None)
    return part if move is None else move(device)


def _about_equilibrium(
    config: Settings,
    world: World,
    model: Model,
    policy: Policy,
    reward: Reward,
    fit: AnyFit,
) -> EquilibriumRegulator:
    """The direction ``equilibrium``: targets and weights from the group ``reward``."""
    group = "unroll.equilibrium"
    form = quadratic_form_of(reward) if is_named(config.reward) else None
    if form is None:
        raise ConfigError(
            "unroll.direction=equilibrium: expected a quadratic reward; with another one,"
            " unroll.direction=gradient"
        )
    settings = dict(config.unroll.equilibrium)
    known_keys(group, config.unroll.equilibrium, {f.name for f in fields(HoldSettings)})
    with under(group):
        hold = HoldSettings(**settings)
    if not hasattr(fit, "describe"):
        raise ConfigError(
            f"fit._target_={config.fit._target_}: expected a fit that knows the centre and the"
            " excursions of its data with unroll.direction=equilibrium; fit=local"
        )
    prices = torch.ones_like(world.action_middle)
    if bool(form.action.any()):
        prices = form.action.diagonal()
    if not bool((prices > 0).all()):
        raise ConfigError(
            f"reward.action={dict(config.reward.action)}: expected a weight > 0 for every action,"
            " or for none, with unroll.direction=equilibrium"
        )
    if gain_of(policy, policy.initial([0])) is None:
        raise ConfigError(
            f"policy._target_={config.policy._target_}: expected an affine policy with"
            " unroll.direction=equilibrium, policy=affine; or unroll.direction=gradient"
        )
    with under("unroll"):
        return EquilibriumRegulator(
            model=model,
            policy=cast(GainedPolicy, policy),
            dt=world.dt,
            target=held(config.reward, world.spec),
            weights={i: float(w) for i, w in enumerate(form.state.diagonal())},
            prices=prices,
            middle=world.action_middle,
            half=world.action_half_range,
            settings=hold,
        )


def build_forward(config: Settings, world: World) -> Forward:
    """The learner of a whole configuration, for a world.  Raises ConfigError."""
    sim, dtype, device = world.sim, world.dtype, world.device
    model = _moved(build_model(config.model, world, dtype, config.seed), device)
    policy = _moved(build_policy(config.policy, sim, dtype, config.seed), device)
    reward = build_reward(config.reward, sim, dtype, device)
    refuse_timed(reward)
    transform = construct(
        "transform",
        config.transform,
        "move",
        "reward",
        "keeps_positive",
        states=model.states,
        generator=torch.Generator().manual_seed(config.seed),
    )
    fit = build_fit(config, world, model)
    observer = build_observer(config.observation, world, model, fit)
    with under("unroll"):
        euler = model.integrates
        step = config.unroll.dt if euler else world.dt
        horizon = Horizon(
            config.unroll.horizon,
            step,
            config.unroll.discount,
            step if euler else 1.0,
            config.unroll.reading,
        )
    noise = None
    if transform.propagates_covariance or config.log.value_error or needs_noise(config.command):
        noise = build_noise(config.noise, fit, model, step / world.dt if euler else 1.0)
    if config.unroll.path not in get_args(Method):
        raise ConfigError(
            f"unroll.path={config.unroll.path}: expected one of {', '.join(get_args(Method))}"
        )
    at_least("unroll.start_deviation", config.unroll.start_deviation, 0)
    if config.unroll.start_deviation > 0 and not transform.propagates_covariance:
        raise ConfigError(
            f"unroll.start_deviation={config.unroll.start_deviation}: expected 0 with this "
            "transform, which leaves the covariance out; transform=first takes it in"
        )
    start_cov = config.unroll.start_deviation**2 * torch.eye(
        model.states, dtype=dtype, device=device
    )
    try:
        choice = choose_path(
            config.unroll.path,
            model,
            policy,
            reward,
            transform,
            horizon,
            noise=noise,
            start_cov=start_cov,
        )
    except ValueError as error:
        raise ConfigError(f"unroll.path={config.unroll.path}: {error}") from error
    path, reason = choice.path, choice.reason
    if config.unroll.direction not in DIRECTIONS:
        raise ConfigError(
            f"unroll.direction={config.unroll.direction}: expected one of {', '.join(DIRECTIONS)}"
        )
    if config.unroll.direction == "regulator":
        with under("unroll"):
            path = Regulator(model, cast(GainedPolicy, policy), reward, horizon, start_cov)
        reason = "Riccati recursion on the learned model"
    if config.unroll.direction == "equilibrium":
        path = _about_equilibrium(config, world, model, policy, reward, fit)
        reason = "Riccati recursion about the equilibrium of the learned model"
    tracked = tracking(model, policy, reward, transform, horizon)
    if tracked is not None and config.unroll.path == "auto":
        path, reason = tracked, "goal-tracking loop, its adjoint written out"
    if config.unroll.start not in STARTS:
        raise ConfigError(
            f"unroll.start={config.unroll.start}: expected one of {', '.join(STARTS)}"
        )
    if config.unroll.start == "origin":
        path = FromOrigin(path, target_of(reward))
    check_start(config.command, world)
    with under("exploration"):
        learner = Learner(
            model=model,
            policy=policy,
            fit=fit,
            noise=noise,
            value=path,
            step_rule=construct("step", config.step, "initial"),
            exploration=build_exploration(config.exploration, world.dt, model.regressors),
            command=build_command(config.command, world, model, policy, noise),
            observer=observer,
        )
    check_memory(learner, world, config.seeds, config.compute.native)
    indicator = ValueErrorIndicator(choice.generic) if config.log.value_error else None
    return Forward(learner, reason, indicator)
