"""From a composed configuration to objects.  Strings end here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast, get_args

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from edtorch.app.checks import at_least, check_keys, check_numbers, check_seeds
from edtorch.app.compute import (
    Compute,
    check_machine,
    check_memory,
    check_recording,
    plan,
    plan_inverse,
    uncompiled,
)
from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError, under, unknown_key
from edtorch.app.inverse import (
    build_controller,
    build_inverse_learner,
    has_inverse,
    inverse_path,
)
from edtorch.app.limit import (
    build_command,
    build_exploration,
    build_schedule,
    check_start,
    needs_noise,
    variant,
)
from edtorch.app.observation import build_deviations, build_observer, check_unobserved
from edtorch.inverse.controller import InverseController
from edtorch.inverse.forward import distance_cost, tracking
from edtorch.learner.filter import JointFilter
from edtorch.learner.learner import AnyLearner, Learner
from edtorch.learner.observer import Observer
from edtorch.learner.schedule import Schedule
from edtorch.model.features import Affine, FeatureMap, Identity, Pairwise, Trigonometric
from edtorch.model.fit import Fit
from edtorch.model.models import DerivativeModel, Model
from edtorch.model.noise import BayesianNoise, Noise
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.run.checkpoint import PolicyCard
from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.value.choose import Wish, choose_path
from edtorch.value.error_estimate import ValueErrorIndicator
from edtorch.value.linear.regulator import Regulator
from edtorch.value.unroll import FromOrigin, Horizon
from sims.base import Quantity, Sim, Spec

FEATURES: Mapping[str, Callable[[int], FeatureMap]] = {
    "identity": Identity,
    "affine": Affine,
    "pairwise": Pairwise,
    "trigonometric": Trigonometric,
}
STARTS = ("state", "origin")
DIRECTIONS = ("gradient", "regulator")
FeaturedActor = LinearPolicy | InverseController
Shapes = dict[str, tuple[int, ...]]


def build_features(key: str, config: Any, inputs: int, spec: Spec, seed: int) -> FeatureMap:
    """A feature map from its name, or from a ``_target_`` with its arguments."""
    if not isinstance(config, DictConfig):
        if config not in FEATURES:
            raise ConfigError(
                f"{key}={config}: expected one of {', '.join(FEATURES)},"
                " or a mapping with a _target_"
            )
        return FEATURES[config](inputs)
    generator = torch.Generator().manual_seed(seed)
    more = {"generator": generator, "spec": spec} | (
        {} if "inputs" in config else {"inputs": inputs}
    )
    features = construct(key, config, "forward", **more)
    taken = getattr(features, "inputs", None)
    if taken != inputs:
        raise ConfigError(f"{key}.inputs={taken}: expected {inputs}, the size of what it is given")
    if not isinstance(getattr(features, "outputs", None), int):
        raise ConfigError(
            f"{key}._target_={config._target_}: expected a feature map, which knows its outputs"
        )
    return features


def _features_of(
    group: str, config: Any, inputs: int, spec: Spec, seed: int
) -> tuple[FeatureMap, DictConfig]:
    """The feature map of a model or policy, and the rest of its node."""
    if not isinstance(config, DictConfig) or "features" not in config:
        raise ConfigError(f"{group}={config}: expected a mapping with _target_ and features")
    features = build_features(f"{group}.features", config.features, inputs, spec, seed)
    return features, OmegaConf.masked_copy(config, [str(k) for k in config if k != "features"])


def build_sim(config: Any) -> Sim:
    """The domain."""
    return construct("domain", config, "initial", "restart", "step", "observe", "outcome")


def changed_domain(domain: Any, changes: Any, key: str) -> DictConfig:
    """The domain's node with the changes asked for under ``key``; unknown names are refused."""
    if not isinstance(domain, DictConfig):
        raise ConfigError(f"domain={domain}: expected a mapping with a _target_")
    known = sorted(str(k) for k in domain if k != "_target_")
    for name, value in changes.items():
        if name not in domain:
            raise ConfigError(unknown_key(f"{key}.{name}={value}", f"{key}.{name}", known))
    return cast(DictConfig, OmegaConf.merge(domain, changes))


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


def build_policy(config: Any, sim: Sim, dtype: torch.dtype, seed: int) -> LinearPolicy:
    """The policy, as a template for one learner."""
    states, actions = len(sim.spec.state), len(sim.spec.action)
    features, rest = _features_of("policy", config, states, sim.spec, seed)
    return construct(
        "policy",
        rest,
        "linear_gain",
        states=states,
        actions=actions,
        features=features,
        dtype=dtype,
    )


def _build_model(config: Any, world: World, dtype: torch.dtype, seed: int) -> Model:
    states, actions = len(world.spec.state), len(world.spec.action)
    features, rest = _features_of("model", config, states + actions, world.spec, seed)
    return construct(
        "model",
        rest,
        "linear_dynamics",
        states=states,
        actions=actions,
        features=features,
        period=world.period,
    )


def _build_fit(config: DictConfig, world: World, model: Model) -> Fit | JointFilter:
    deviations = build_deviations(config.observation, world)
    return construct("fit", config.fit, "initial", "update", model=model, deviations=deviations)


def _build_noise(config: Any, fit: Fit | JointFilter, model: Model, stretch: float) -> Noise:
    own = [str(k) for k in config if not str(k).startswith("exploration")]
    rest = OmegaConf.masked_copy(config, own)
    noise = construct("noise", rest, "covariance", "update", stretch=stretch)
    if isinstance(noise, BayesianNoise) and "P" not in fit.initial(model.weight):
        raise ConfigError(
            f"noise._target_={config._target_}: expected a fit that knows how sure it is, "
            "fit=least_squares or fit=bayesian"
        )
    return noise


def build_frozen_observer(config: DictConfig, world: World) -> Observer | None:
    """What a frozen policy of this configuration estimates the state with."""
    if has_inverse(config):
        return None
    model = _build_model(config.model, world, world.dtype, config.seed)
    return build_observer(config.observation, world, model, _build_fit(config, world, model))


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


def build_budget(config: Any) -> Budget:
    """What a learner may use.  Raises ConfigError."""
    if config.seconds is not None and not (math.isfinite(config.seconds) and config.seconds > 0):
        raise ConfigError(f"train.seconds={config.seconds}: expected a finite number > 0, or null")
    for name in ("episodes", "rides"):
        if config[name] is not None:
            at_least(f"train.{name}", config[name], 1)
    if config.seconds is None and config.episodes is None and config.rides is None:
        raise ConfigError(
            "train.seconds=null, train.episodes=null, train.rides=null: expected a number for one"
        )
    return Budget(config.seconds, config.episodes, config.rides)


@dataclass(frozen=True)
class _Forward:
    """A learner with a forward model; path, indicator, compiled: as in ``Setup``."""

    learner: Learner
    path: str
    indicator: ValueErrorIndicator | None
    compiled: Learner | None


def _build_forward(config: DictConfig, world: World, compute: Compute) -> _Forward:
    sim, dtype, device = world.sim, compute.dtype, compute.device
    model = _build_model(config.model, world, dtype, config.seed).to(device)
    policy = build_policy(config.policy, sim, dtype, config.seed).to(device)
    reward = build_reward(config.reward, sim, dtype, device)
    transform = construct(
        "transform",
        config.transform,
        "move",
        "reward",
        "keeps_positive",
        states=model.states,
        generator=torch.Generator().manual_seed(config.seed),
    )
    fit = _build_fit(config, world, model)
    observer = build_observer(config.observation, world, model, fit)
    with under("unroll"):
        euler = isinstance(model, DerivativeModel)
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
        noise = _build_noise(config.noise, fit, model, step / world.dt if euler else 1.0)
    if config.unroll.path not in get_args(Wish):
        raise ConfigError(
            f"unroll.path={config.unroll.path}: expected one of {', '.join(get_args(Wish))}"
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
    path, reason, compilable = choice.path, choice.reason, choice.compiled
    if config.unroll.direction not in DIRECTIONS:
        raise ConfigError(
            f"unroll.direction={config.unroll.direction}: expected one of {', '.join(DIRECTIONS)}"
        )
    if config.unroll.direction == "regulator":
        with under("unroll"):
            path = compilable = Regulator(model, policy, reward, horizon, start_cov)
        reason = "Riccati recursion on the learned model"
    tracked = tracking(model, policy, reward, transform, horizon)
    if tracked is not None and config.unroll.path == "auto":
        path, reason, compilable = tracked, "goal-tracking loop, its adjoint written out", None
    if config.unroll.start not in STARTS:
        raise ConfigError(
            f"unroll.start={config.unroll.start}: expected one of {', '.join(STARTS)}"
        )
    if config.unroll.start == "origin":
        path = FromOrigin(path)
        compilable = None if compilable is None else FromOrigin(compilable)
    check_start(config.command, world)
    with under("noise"):
        learner = Learner(
            model=model,
            policy=policy,
            fit=fit,
            noise=noise,
            value=path,
            step_rule=construct("step", config.step, "initial"),
            exploration=build_exploration(config.noise, world.dt),
            command=build_command(config.command, world, model, policy, noise),
            observer=observer,
        )
    check_memory(learner, world, config.seeds)
    indicator = ValueErrorIndicator(choice.generic) if config.log.value_error else None
    compiled = None
    if observer is not None:
        reason, compilable = f"{reason}; estimates of the state, which are not compiled", None
    if compute.compiled and compilable is not None:
        compiled = replace(learner, value=compilable)
    return _Forward(learner, reason, indicator, compiled)


@dataclass(frozen=True)
class Setup:
    """Everything that a training run is made of.

    calm: a new world to evaluate in; schedule: when policies are improved; path: how value and
    gradient are found, in words; compiled: the same learner as a compiler wants it, None if it is
    not to be compiled.
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
    compute: Compute
    compiled: Learner | None


def _check(config: DictConfig) -> None:
    """Refuse keys and numbers that are wrong whatever is built of them."""
    check_keys(config)
    check_numbers(config)
    check_seeds(config)
    at_least("eval.episodes", config.eval.episodes, 0)
    at_least("eval.keep", config.eval.keep, 0)
    for place, minutes in enumerate(config.eval.minutes):
        if not minutes > 0:
            raise ConfigError(f"eval.minutes[{place}]={minutes}: expected a number > 0")
    at_least("compute.threads", config.compute.threads, 1)
    at_least("log.every", config.log.every, 1)
    at_least("log.checkpoint", config.log.checkpoint, config.log.every)
    at_least("compute.compile_after", config.compute.compile_after, 0)


def build(config: DictConfig) -> Setup:
    """Objects for ``edtorch-train``.  Raises ConfigError, which names the key."""
    _check(config)
    budget = build_budget(config.train)
    if config.train.until is not None:
        raise ConfigError(
            f"train.until={config.train.until}: expected null without a rival; a learner has"
            " train.seconds, train.episodes or train.rides"
        )
    sim = build_sim(config.domain)
    if config.log.transitions:
        check_recording(budget, World(sim), config.seeds)
    if has_inverse(config):
        return _assemble(config, sim, budget, plan_inverse(config.compute, budget, World(sim)))
    compute = plan(config.compute, budget, World(sim), config.seeds)
    if config.log.transitions:
        if compute.required:
            raise ConfigError(
                "log.transitions=true: expected compute.compile=auto or off; a compiled tick does"
                " not say what happened in it"
            )
        compute = uncompiled(compute, config.compute)
    setup = _assemble(config, sim, budget, compute)
    if compute.compiled and setup.compiled is None:
        if compute.required:
            raise ConfigError(
                "compute.compile=on: expected a closed form to compile, but this run takes the "
                f"{setup.path}"
            )
        setup = _assemble(config, sim, budget, uncompiled(compute, config.compute))
    check_machine(compute)
    return setup


def _assemble(config: DictConfig, sim: Sim, budget: Budget, compute: Compute) -> Setup:
    if config.eval.keep and not (sim.spec.goal and config.eval.episodes):
        raise ConfigError(
            f"eval.keep={config.eval.keep}: expected 0 without a goal in the domain and"
            f" eval.episodes, here {sim.spec.name} and {config.eval.episodes}"
        )
    unwrap = config.observation.unwrap
    with under("observation"):
        world = World(sim, compute.dtype, compute.device, unwrap)
    evaluated = changed_domain(config.domain, config.eval.domain, "eval.domain")
    if config.eval.domain:
        build_sim(evaluated)
    indicator = compiled = None
    if has_inverse(config):
        check_unobserved(config.observation)
        learner = build_inverse_learner(config, sim, compute.dtype)
        check_memory(learner, world, config.seeds)
        path = inverse_path(learner)
    else:
        forward = _build_forward(config, world, compute)
        learner, path = forward.learner, forward.path
        indicator, compiled = forward.indicator, forward.compiled
    # Not before the population is known to fit in memory.
    seeds = list(range(config.seed, config.seed + config.seeds))
    card = policy_card(sim, learner.policy, seeds)

    def calm() -> World:
        return World(build_sim(evaluated), compute.dtype, compute.device, unwrap)

    return Setup(
        learner,
        world,
        calm,
        seeds,
        budget,
        build_schedule(config.schedule, world.dt),
        card,
        path,
        indicator,
        compute,
        compiled,
    )
