"""Dataclass schemas of every configuration group: names and types.

Values are checked by the constructors that receive them, whose arguments have the same names; see
``edtorch.app.build``.  A group option of a user's own needs no schema.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class FunctionConfig:
    """A function, by its full name."""

    _target_: str = MISSING
    _partial_: bool = True


@dataclass
class BicycleConfig:
    """The bicycle of Randlov & Alstrom; see ``sims.bicycle.Bicycle``."""

    _target_: str = "sims.bicycle.Bicycle"
    dt: float = 0.01
    time_limit: float = 1000.0
    start_heading_low: float = -math.pi
    start_heading_high: float = math.pi
    goal_radius: float = 10.0
    clip_action: bool = True
    noise: float = 0.02
    lean_acceleration: bool = False
    state_scale: dict[str, float] = field(default_factory=dict)
    action_scale: dict[str, float] = field(default_factory=dict)
    integrate: FunctionConfig = field(
        default_factory=lambda: FunctionConfig("sims.bicycle.semi_implicit")
    )


@dataclass
class LinearSystemConfig:
    """A linear system with noise; see ``sims.linear.LinearSystem``."""

    _target_: str = "sims.linear.LinearSystem"
    state_matrix: list[list[float]] = MISSING
    action_matrix: list[list[float]] = MISSING
    noise: float = 0.1
    start: float = 1.0
    dt: float = 1.0
    time_limit: float = 50.0


@dataclass
class GymnasiumConfig:
    """Any Gymnasium environment with box spaces; see ``sims.from_gymnasium.GymnasiumSim``."""

    _target_: str = "sims.from_gymnasium.GymnasiumSim"
    env_id: str = MISSING
    dt: float | None = None
    time_limit: float = 1000.0
    termination: str = "failure"
    state_scales: list[float] | None = None
    action_scales: list[float] | None = None
    env_kwargs: dict[str, Any] = field(default_factory=dict)


@dataclass
class ModelConfig:
    """A model linear in features; ``features`` is a name or a ``_target_`` with its arguments."""

    _target_: str = MISSING
    features: Any = "identity"


@dataclass
class RateFitConfig:
    """A gradient rule of ``edtorch.fit``."""

    _target_: str = MISSING
    rate: float = MISSING


@dataclass
class NormalisedFitConfig(RateFitConfig):
    """``edtorch.fit.NormalisedSquaredError``."""

    floor: float = 1e-3


@dataclass
class LeastSquaresConfig:
    """``edtorch.fit.RecursiveLeastSquares``."""

    _target_: str = MISSING
    prior: float = 1000.0
    forgetting: float = 1.0


@dataclass
class PolicyConfig:
    """A policy linear in features; ``features`` as in the model."""

    _target_: str = MISSING
    features: Any = "identity"


@dataclass
class RewardConfig:
    """Minus a weighted sum of squares, physical units: weights by name of state and action."""

    state: dict[str, float] = field(default_factory=dict)
    action: dict[str, float] = field(default_factory=dict)


@dataclass
class NoiseConfig:
    """exploration: scaled standard deviation; rate: of nu~ (used where covariance is propagated)."""

    exploration: float = 0.05
    rate: float = 1.0


@dataclass
class TransformConfig:
    """A transform of ``edtorch.transform``."""

    _target_: str = MISSING


@dataclass
class UnrollConfig:
    """horizon: steps; dt: seconds a step (derivative form); discount: per second, or per step;
    path: auto, closed_form or generic."""

    horizon: int = 30
    dt: float = 0.051
    discount: float = 1.0
    path: str = "auto"


@dataclass
class SaturatedStepConfig:
    """``edtorch.update.SaturatedStep``."""

    _target_: str = MISSING
    alpha: float = MISSING
    beta: float = MISSING


@dataclass
class PlainStepConfig:
    """``edtorch.update.PlainStep``."""

    _target_: str = MISSING
    alpha: float = MISSING


@dataclass
class BudgetConfig:
    """Per learner, whichever ends first; null: unlimited."""

    seconds: float | None = None
    episodes: int | None = None
    rides: int | None = None


@dataclass
class EvalConfig:
    """episodes: fresh ones per seed after training; 0: none."""

    episodes: int = 100


@dataclass
class ComputeConfig:
    """precision: of the learner (the sim is float64); threads: of torch in this process."""

    precision: str = "float64"
    threads: int = 1


@dataclass
class LogConfig:
    """every: simulated seconds between two rows; checkpoint: between two saves of everything."""

    every: int = 5
    checkpoint: int = 500
    tensorboard: bool = True
    figures: bool = True
    animation: bool = True
    progress: bool = True


@dataclass
class TrainConfig:
    """Everything ``edtorch-train`` knows."""

    domain: Any = MISSING
    model: Any = MISSING
    fit: Any = MISSING
    policy: Any = MISSING
    reward: RewardConfig = field(default_factory=RewardConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    transform: Any = MISSING
    unroll: UnrollConfig = field(default_factory=UnrollConfig)
    step: Any = MISSING
    train: BudgetConfig = field(default_factory=BudgetConfig)
    eval: EvalConfig = field(default_factory=EvalConfig)
    compute: ComputeConfig = field(default_factory=ComputeConfig)
    log: LogConfig = field(default_factory=LogConfig)
    seed: int = 0
    seeds: int = 8
    debug: bool = False


@dataclass
class EvaluateConfig:
    """Everything ``edtorch-eval`` knows.

    run: folder of a run; policy: a file, by default the run's own; episodes: per seed; domain:
    settings that replace the run's own.
    """

    run: str = MISSING
    policy: str | None = None
    episodes: int = 100
    domain: dict[str, Any] = field(default_factory=dict)
    threads: int = 1
    debug: bool = False


SCHEMAS: dict[str, dict[str, type]] = {
    "domain": {
        "bicycle_schema": BicycleConfig,
        "linear_schema": LinearSystemConfig,
        "gymnasium_schema": GymnasiumConfig,
    },
    "model": {"model_schema": ModelConfig},
    "fit": {
        "rate_schema": RateFitConfig,
        "normalised_schema": NormalisedFitConfig,
        "least_squares_schema": LeastSquaresConfig,
    },
    "policy": {"policy_schema": PolicyConfig},
    "transform": {"transform_schema": TransformConfig},
    "step": {"saturated_schema": SaturatedStepConfig, "plain_schema": PlainStepConfig},
}


def register() -> None:
    """Make the schemas known to Hydra."""
    store = ConfigStore.instance()
    store.store(name="train_schema", node=TrainConfig)
    store.store(name="evaluate_schema", node=EvaluateConfig)
    for group, options in SCHEMAS.items():
        for name, node in options.items():
            store.store(group=group, name=name, node=node)
