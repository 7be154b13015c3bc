"""From a composed configuration to objects.  Strings end here."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from edtorch.app.checks import at_least, check_keys, check_numbers, check_seeds
from edtorch.app.compute import Compute, check_memory, plan
from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError, under
from edtorch.checkpoint import PolicyCard
from edtorch.dispatch import Wish, choose_path
from edtorch.features import Affine, FeatureMap, Identity, Pairwise, Trigonometric
from edtorch.fit import Fit
from edtorch.learner import Learner
from edtorch.models import DerivativeModel, Model
from edtorch.noise import BayesianNoise, Noise
from edtorch.policies import LinearPolicy
from edtorch.records import Budget
from edtorch.rewards import QuadraticReward
from edtorch.unroll import Horizon
from edtorch.value_error import ValueErrorIndicator
from edtorch.world import World
from sims.base import Quantity, Sim

FEATURES: Mapping[str, Callable[[int], FeatureMap]] = {
    "identity": Identity,
    "affine": Affine,
    "pairwise": Pairwise,
    "trigonometric": Trigonometric,
}


def build_features(key: str, config: Any, inputs: int, seed: int) -> FeatureMap:
    """A feature map from its name, or from a ``_target_`` with its arguments."""
    if not isinstance(config, DictConfig):
        if config not in FEATURES:
            raise ConfigError(
                f"{key}={config}: expected one of {', '.join(FEATURES)},"
                " or a mapping with a _target_"
            )
        return FEATURES[config](inputs)
    generator = torch.Generator().manual_seed(seed)
    more = {"generator": generator} | ({} if "inputs" in config else {"inputs": inputs})
    features = construct(key, config, "forward", **more)
    taken = getattr(features, "inputs", None)
    if taken != inputs:
        raise ConfigError(f"{key}.inputs={taken}: expected {inputs}, the size of what it is given")
    if not isinstance(getattr(features, "outputs", None), int):
        raise ConfigError(
            f"{key}._target_={config._target_}: expected a feature map, which knows its outputs"
        )
    return features


def _features_of(group: str, config: Any, inputs: int, seed: int) -> tuple[FeatureMap, DictConfig]:
    """The feature map of a model or policy, and the rest of its node."""
    if not isinstance(config, DictConfig) or "features" not in config:
        raise ConfigError(f"{group}={config}: expected a mapping with _target_ and features")
    features = build_features(f"{group}.features", config.features, inputs, seed)
    return features, OmegaConf.masked_copy(config, [str(k) for k in config if k != "features"])


def build_sim(config: Any) -> Sim:
    """The domain."""
    return construct("domain", config, "initial", "restart", "step", "observe", "outcome")


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


def build_reward(
    config: Any, sim: Sim, dtype: torch.dtype, device: torch.device | None = None
) -> QuadraticReward:
    """The shaping reward, in scaled units."""
    if not any(weight > 0 for weight in config.state.values()):
        names = ", ".join(q.name for q in sim.spec.state)
        raise ConfigError(
            f"reward.state={dict(config.state)}: expected a weight > 0 for one of {names}"
        )
    state = _weights("reward.state", config.state, sim.spec.state)
    action = _weights("reward.action", config.action, sim.spec.action)
    return QuadraticReward(state.to(device, dtype), action.to(device, dtype))


def build_policy(config: Any, sim: Sim, dtype: torch.dtype, seed: int) -> LinearPolicy:
    """The policy, as a template for one learner."""
    states, actions = len(sim.spec.state), len(sim.spec.action)
    features, rest = _features_of("policy", config, states, seed)
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
    features, rest = _features_of("model", config, states + actions, seed)
    return construct(
        "model",
        rest,
        "linear_dynamics",
        states=states,
        actions=actions,
        features=features,
        period=world.period,
    )


def _build_noise(config: Any, fit: Fit, model: Model, stretch: float) -> Noise:
    rest = OmegaConf.masked_copy(config, [str(k) for k in config if k != "exploration"])
    noise = construct("noise", rest, "covariance", "update", stretch=stretch)
    if isinstance(noise, BayesianNoise) and "P" not in fit.initial(model.weight):
        raise ConfigError(
            f"noise._target_={config._target_}: expected a fit that knows how sure it is, "
            "fit=least_squares or fit=bayesian"
        )
    return noise


def policy_card(sim: Sim, policy: LinearPolicy, seeds: list[int]) -> PolicyCard:
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


def _build_budget(config: Any) -> Budget:
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
class Setup:
    """Everything that a training run is made of.

    path: how value and gradient are found, in words; compiled: the same learner as a compiler wants
    it, None if it is not to be compiled.
    """

    learner: Learner
    world: World
    seeds: list[int]
    budget: Budget
    card: PolicyCard
    path: str
    indicator: ValueErrorIndicator | None
    compute: Compute
    compiled: Learner | None


def build(config: DictConfig) -> Setup:
    """Objects for ``edtorch-train``.  Raises ConfigError, which names the key."""
    check_keys(config)
    check_numbers(config)
    check_seeds(config)
    at_least("eval.episodes", config.eval.episodes, 0)
    at_least("compute.threads", config.compute.threads, 1)
    at_least("log.every", config.log.every, 1)
    at_least("log.checkpoint", config.log.checkpoint, config.log.every)
    at_least("compute.compile_after", config.compute.compile_after, 0)
    budget = _build_budget(config.train)
    sim = build_sim(config.domain)
    compute = plan(config.compute, budget, World(sim), config.seeds)
    setup = _assemble(config, sim, budget, compute)
    if compute.compiled and setup.compiled is None:
        if compute.required:
            raise ConfigError(
                "compute.compile=on: expected a closed form to compile, but this run takes the "
                f"{setup.path}"
            )
        compute = replace(compute, compiled=False)
        if config.compute.precision == "auto":
            compute = replace(compute, dtype=torch.float64)
        setup = _assemble(config, sim, budget, compute)
    return setup


def _assemble(config: DictConfig, sim: Sim, budget: Budget, compute: Compute) -> Setup:
    dtype, device = compute.dtype, compute.device
    world = World(sim, dtype, device)
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
    fit = construct("fit", config.fit, "initial", "update")
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
    if transform.propagates_covariance or config.log.value_error:
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
    with under("noise"):
        learner = Learner(
            model=model,
            policy=policy,
            fit=fit,
            noise=noise,
            value=choice.path,
            step_rule=construct("step", config.step, "initial"),
            exploration=config.noise.exploration,
        )
    check_memory(learner, world, config.seeds)
    indicator = ValueErrorIndicator(choice.generic) if config.log.value_error else None
    seeds = [config.seed + k for k in range(config.seeds)]
    card = policy_card(sim, policy, seeds)
    compiled = None
    if compute.compiled and choice.compiled is not None:
        compiled = replace(learner, value=choice.compiled)
    return Setup(learner, world, seeds, budget, card, choice.reason, indicator, compute, compiled)
