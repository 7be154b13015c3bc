"""From a composed configuration to objects.  Strings end here."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import torch
from hydra.utils import get_class, get_method, instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import Tensor

from edtorch.app.errors import ConfigError, under
from edtorch.checkpoint import PolicyCard
from edtorch.dispatch import Wish, choose_path
from edtorch.features import Affine, FeatureMap, Identity, Pairwise, Trigonometric
from edtorch.interact import Budget
from edtorch.learner import Learner, ResidualNoise
from edtorch.models import DerivativeModel, NextStateModel
from edtorch.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.unroll import Horizon
from edtorch.world import World
from sims.base import Quantity, Sim

FEATURES: Mapping[str, type[FeatureMap]] = {
    "identity": Identity,
    "affine": Affine,
    "pairwise": Pairwise,
    "trigonometric": Trigonometric,
}
PRECISIONS = {"float64": torch.float64, "float32": torch.float32}


def _known_keys(group: str, config: DictConfig, known: set[str]) -> None:
    for key, value in config.items():
        if str(key) not in known:
            raise ConfigError(
                f"{group}.{key}={value}: unknown key; {group} has {', '.join(sorted(known))}"
            )


def _argument(value: Any) -> Any:
    """A constructor's argument: nested targets become objects, other nodes plain containers."""
    if isinstance(value, DictConfig) and set(value) == {"_target_", "_partial_"}:
        # The function itself: Hydra's own partial would vet its target again at every call.
        return get_method(value["_target_"])
    if isinstance(value, DictConfig) and "_target_" in value:
        return instantiate(value)
    if isinstance(value, DictConfig | ListConfig):
        return OmegaConf.to_container(value)
    return value


def _construct(group: str, config: Any, /, **more: Any) -> Any:
    """Instantiate a ``_target_`` node; keys that its constructor does not know are refused."""
    if not isinstance(config, DictConfig) or "_target_" not in config:
        raise ConfigError(f"{group}={config}: expected a mapping with a _target_")
    try:
        target = get_class(config["_target_"])
    except Exception as error:
        raise ConfigError(f"{group}._target_={config['_target_']}: {error}") from error
    accepted = inspect.signature(target).parameters
    given = set(accepted) - set(more)
    _known_keys(group, config, given | {"_target_"})
    arguments = {str(k): _argument(v) for k, v in config.items() if k != "_target_"}
    arguments |= {k: v for k, v in more.items() if k in accepted}
    # Hydra looks the target up and vets it; called here, its errors reach us as they are.
    constructor = instantiate({"_target_": config["_target_"], "_partial_": True})
    with under(group):
        return constructor(**arguments)


def build_features(key: str, config: Any, inputs: int, seed: int) -> FeatureMap:
    """A feature map from its name, or from a ``_target_`` with its arguments."""
    if isinstance(config, DictConfig):
        generator = torch.Generator().manual_seed(seed)
        more = {"generator": generator} | ({} if "inputs" in config else {"inputs": inputs})
        return _construct(key, config, **more)
    if config not in FEATURES:
        raise ConfigError(
            f"{key}={config}: expected one of {', '.join(FEATURES)}, or a mapping with a _target_"
        )
    return FEATURES[config](inputs)


def build_sim(config: Any) -> Sim:
    """The domain."""
    return _construct("domain", config)


def _weights(key: str, config: Mapping[str, float], quantities: tuple[Quantity, ...]) -> Tensor:
    """Diagonal cost in scaled units from weights in physical ones, by name."""
    names = [q.name for q in quantities]
    for name, weight in config.items():
        if name not in names:
            raise ConfigError(f"{key}.{name}={weight}: expected one of {', '.join(names)}")
        if not weight >= 0:
            raise ConfigError(f"{key}.{name}={weight}: expected a number >= 0")
    return torch.diag(
        torch.tensor([config.get(q.name, 0.0) * q.scale**2 for q in quantities]).to(torch.float64)
    )


def build_reward(config: Any, sim: Sim, dtype: torch.dtype) -> QuadraticReward:
    """The shaping reward, in scaled units."""
    if not any(weight > 0 for weight in config.state.values()):
        names = ", ".join(q.name for q in sim.spec.state)
        raise ConfigError(
            f"reward.state={dict(config.state)}: expected a weight > 0 for one of {names}"
        )
    state = _weights("reward.state", config.state, sim.spec.state)
    action = _weights("reward.action", config.action, sim.spec.action)
    return QuadraticReward(state.to(dtype), action.to(dtype))


def build_policy(config: Any, sim: Sim, dtype: torch.dtype, seed: int) -> LinearPolicy:
    """The policy, as a template for one learner."""
    states, actions = len(sim.spec.state), len(sim.spec.action)
    features = build_features("policy.features", config.features, states, seed)
    rest = OmegaConf.masked_copy(config, [str(k) for k in config if k != "features"])
    return _construct(
        "policy", rest, states=states, actions=actions, features=features, dtype=dtype
    )


def _build_model(
    config: Any, world: World, dtype: torch.dtype, seed: int
) -> DerivativeModel | NextStateModel:
    states, actions = len(world.spec.state), len(world.spec.action)
    features = build_features("model.features", config.features, states + actions, seed)
    rest = OmegaConf.masked_copy(config, [str(k) for k in config if k != "features"])
    return _construct(
        "model", rest, states=states, actions=actions, features=features, period=world.period
    )


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


def build_precision(config: Any) -> torch.dtype:
    """The learner's number type."""
    if config.precision not in PRECISIONS:
        raise ConfigError(
            f"compute.precision={config.precision}: expected one of {', '.join(PRECISIONS)}"
        )
    return PRECISIONS[config.precision]


def at_least(key: str, value: float | None, least: float) -> None:
    """Refuse ``value`` below ``least``; None passes."""
    if value is not None and not value >= least:
        raise ConfigError(f"{key}={value}: expected a number >= {least:g}")


def _check_schema(config: DictConfig, prefix: str = "") -> None:
    """Refuse keys that were forced in with "+" beside those of a group's schema."""
    for key in config:
        node = config._get_node(key)
        name = f"{prefix}{key}"
        if isinstance(node, DictConfig) and not node._is_none():
            kind = OmegaConf.get_type(node)
            fields = getattr(kind, "__dataclass_fields__", None)
            if fields is not None:
                _known_keys(name, node, set(fields))


@dataclass(frozen=True)
class Setup:
    """Everything that a training run is made of."""

    learner: Learner
    world: World
    seeds: list[int]
    budget: Budget
    card: PolicyCard
    path: str


def build(config: DictConfig) -> Setup:
    """Objects for ``edtorch-train``.  Raises ConfigError, which names the key."""
    _check_schema(config)
    at_least("seed", config.seed, 0)
    at_least("seeds", config.seeds, 1)
    at_least("eval.episodes", config.eval.episodes, 0)
    at_least("compute.threads", config.compute.threads, 1)
    at_least("log.every", config.log.every, 1)
    at_least("log.checkpoint", config.log.checkpoint, config.log.every)
    for name in ("seconds", "episodes", "rides"):
        at_least(f"train.{name}", config.train[name], 1 if name != "seconds" else 1e-9)
    with under("train"):
        budget = Budget(config.train.seconds, config.train.episodes, config.train.rides)

    dtype = build_precision(config.compute)
    sim = build_sim(config.domain)
    world = World(sim, dtype)
    model = _build_model(config.model, world, dtype, config.seed)
    policy = build_policy(config.policy, sim, dtype, config.seed)
    reward = build_reward(config.reward, sim, dtype)
    transform = _construct("transform", config.transform)
    with under("unroll"):
        euler = isinstance(model, DerivativeModel)
        step = config.unroll.dt if euler else world.dt
        horizon = Horizon(
            config.unroll.horizon, step, config.unroll.discount, step if euler else 1.0
        )
    if config.unroll.path not in get_args(Wish):
        raise ConfigError(
            f"unroll.path={config.unroll.path}: expected one of {', '.join(get_args(Wish))}"
        )
    try:
        choice = choose_path(config.unroll.path, model, policy, reward, transform, horizon)
    except ValueError as error:
        raise ConfigError(f"unroll.path={config.unroll.path}: {error}") from error
    with under("noise"):
        noise = ResidualNoise(config.noise.rate)
        learner = Learner(
            model=model,
            policy=policy,
            fit=_construct("fit", config.fit),
            noise=noise if transform.propagates_covariance else None,
            value=choice.path,
            step_rule=_construct("step", config.step),
            exploration=config.noise.exploration,
        )
    seeds = [config.seed + k for k in range(config.seeds)]
    card = policy_card(sim, policy, seeds)
    return Setup(learner, world, seeds, budget, card, choice.reason)
