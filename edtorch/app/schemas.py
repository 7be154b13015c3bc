"""Dataclass schemas of every configuration group: names and types.

Values are checked by the constructors that receive them, whose arguments have the same names; see
``edtorch.app.build``.  A group option of a user's own needs no schema.
"""

from __future__ import annotations

import math
from dataclasses import MISSING as DATACLASS_MISSING
from dataclasses import Field, dataclass, field, fields, make_dataclass
from typing import Any, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from edtorch.rivals.adaptive_lqr import AdaptiveLqr
from edtorch.rivals.fitted_q import FittedQ
from edtorch.rivals.lqr import Lqr
from edtorch.rivals.lspi import Lspi
from edtorch.rivals.pegasus import Pegasus
from edtorch.rivals.ppo import PPO
from edtorch.rivals.reinforce import Reinforce
from edtorch.rivals.sac import SAC
from edtorch.rivals.sarsa import Sarsa


@dataclass
class FunctionConfig:
    """A function, by its full name."""

    _target_: str = MISSING
    _partial_: bool = True


@dataclass
class PhysicsConfig:
    """Constants of the bicycle; see ``sims.bicycle.Physics`` for what each is."""

    _target_: str = "sims.bicycle.Physics"
    v: float = 10 / 3.6
    g: float = 9.82
    d_CM: float = 0.30
    c: float = 0.66
    h: float = 0.94
    l: float = 1.11  # noqa: E741 (the article's letter)
    M_c: float = 15.0
    M_d: float = 1.7
    M_p: float = 60.0
    r: float = 0.34
    theta_max: float = 1.3963
    omega_max: float = math.pi / 15
    true_precession: bool = False


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
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    integrate: FunctionConfig = field(
        default_factory=lambda: FunctionConfig("sims.bicycle.semi_implicit")
    )
    start_lean: float = 0.0
    start_handlebar: float = 0.0
    spread: float = 0.0
    gust: float = 0.0
    gust_seconds: float = 1.0
    gust_every: float = 5.0
    change_at: float | None = None
    change: dict[str, float] = field(default_factory=dict)


@dataclass
class SlalomConfig(BicycleConfig):
    """Gates instead of a goal; see ``sims.bicycle.slalom.Slalom``."""

    _target_: str = "sims.bicycle.slalom.Slalom"
    time_limit: float = 300.0
    start_heading_low: float = -math.pi / 2 - 0.2
    start_heading_high: float = -math.pi / 2 + 0.2
    gates: int = 10
    gate_width: float = 4.0
    gate_spacing: float = 40.0
    gate_offset: float = 5.0
    look_ahead: float = 6.0


@dataclass
class SensedConfig:
    """Any domain seen through sensors; see ``sims.sensing.Sensed``."""

    _target_: str = "sims.sensing.Sensed"
    sim: Any = MISSING
    noise: dict[str, float] = field(default_factory=dict)
    delay: int = 0


@dataclass
class CardeaConfig:
    """An arm on a self-balancing base; see ``sims.cardea.Cardea``."""

    _target_: str = "sims.cardea.Cardea"
    dt: float = 0.02
    physics_dt: float = 0.004
    time_limit: float = 2.0
    torque_noise: float = 0.02
    start: list[float] | None = None
    goal: list[float] | None = None
    clearance: float = 0.03
    max_tilt: float = 0.5
    reached_error: float = 0.1
    reached_speed: float = 0.2
    workers: int = 0
    state_scale: dict[str, float] = field(default_factory=dict)
    action_scale: dict[str, float] = field(default_factory=dict)


@dataclass
class LinearSystemConfig:
    """A linear system with noise; see ``sims.linear.LinearSystem``."""

    _target_: str = "sims.linear.LinearSystem"
    state_matrix: Any = MISSING  # rows of numbers; a typed list would refuse whole ones
    action_matrix: Any = MISSING
    noise: float = 0.1
    start: float = 1.0
    dt: float = 1.0
    time_limit: float = 50.0


@dataclass
class GymnasiumConfig:
    """Any Gymnasium environment with box spaces; see ``sims.from_gymnasium.GymnasiumSim``."""

    _target_: str = "sims.from_gymnasium.GymnasiumSim"
    env_id: str | None = None
    env: Any = None
    dt: float | None = None
    time_limit: float | None = None
    state_scale: Any = None  # numbers in order, or by name
    action_scale: Any = None
    state_names: list[str] | None = None
    action_names: list[str] | None = None
    angles: Any = None
    rates: dict[str, str] | None = None
    headline: str | None = None
    clip_action: bool = True
    termination: str = "failure"
    env_kwargs: dict[str, Any] = field(default_factory=dict)


@dataclass
class ModelConfig:
    """A model linear in features; ``features`` is a name or a ``_target_`` with its arguments."""

    _target_: str = MISSING
    features: Any = "identity"


@dataclass
class RateFitConfig:
    """A gradient rule of ``edtorch.model.fit``."""

    _target_: str = MISSING
    rate: float = MISSING


@dataclass
class NormalisedFitConfig(RateFitConfig):
    """``edtorch.model.fit.NormalisedSquaredError``."""

    floor: float = 1e-3


@dataclass
class LeastSquaresConfig:
    """``edtorch.model.fit.RecursiveLeastSquares``."""

    _target_: str = MISSING
    prior: float = 1000.0
    forgetting: float = 1.0


@dataclass
class AdaptiveConfig:
    """``edtorch.model.fit_adaptive.AdaptiveLeastSquares``."""

    _target_: str = MISSING
    prior: float = 1000.0
    fast: float = 5.0
    slow: float = 0.2
    threshold: float = 3.0
    doubt: float = 1.0


@dataclass
class FilteredConfig:
    """``edtorch.learner.filter.JointFilter``."""

    _target_: str = MISSING
    prior: float = 2.0
    disturbance: float = 0.02


@dataclass
class BayesianFitConfig:
    """``edtorch.model.fit.BayesianLeastSquares``."""

    _target_: str = MISSING
    priors: int = 28


@dataclass
class RidgeConfig:
    """``edtorch.model.fit_ridge.Ridge``."""

    _target_: str = MISSING
    penalty: float = 0.01
    every: int = 25
    later: int = 100
    settled: int = 3000


@dataclass
class DecayingFitConfig:
    """``edtorch.model.fit_decaying.DecayingFit`` of a gradient rule."""

    _target_: str = MISSING
    rule: RateFitConfig = field(default_factory=RateFitConfig)
    decay: float = MISSING


@dataclass
class NoInverseConfig:
    """A forward model and a policy of actions."""

    variant: str = "none"


@dataclass
class InverseConfig:
    """variant: learned or kinematic; features: name of those of the inverse model, or a
    ``_target_``; form, gain, limit: of the policy, see ``edtorch.inverse.policy.InversePolicy``;
    every, recent: see ``edtorch.inverse.learner.InverseLearner``; trust: its ``Trust``."""

    variant: str = MISSING
    features: Any = "structured"
    form: str = "error"
    gain: float = 20.0
    limit: float | None = 30.0
    every: int = 5
    recent: int = 10
    trust_acceleration: float = 100.0
    trust_speed: float = 10.0


@dataclass
class KinematicConfig(InverseConfig):
    """Also length, damping and bent: see ``edtorch.inverse.hand.HandCoordinates``."""

    length: float = 0.15
    damping: float = 0.15
    bent: float = 0.15


@dataclass
class PolicyConfig:
    """A policy linear in features; ``features`` as in the model."""

    _target_: str = MISSING
    features: Any = "identity"


@dataclass
class RewardConfig:
    """``edtorch.rewards.QuadraticReward`` by names of components, physical units: minus weights of
    squared deviations of state and action from their target (a number, or another component), of
    products (cross: triples NAME, NAME, WEIGHT), of components themselves (linear), and of the
    squared distance from the goal, in a domain that has one; by_scale: components with a target and
    no weight, or all where none has either, weigh 1 / scale^2."""

    _target_: str = "edtorch.rewards.QuadraticReward"
    state: dict[str, float] = field(default_factory=dict)
    action: dict[str, float] = field(default_factory=dict)
    goal: float = 0.0
    target: dict[str, Any] = field(default_factory=dict)
    cross: list[Any] = field(default_factory=list)
    linear: dict[str, float] = field(default_factory=dict)
    by_scale: bool = False


@dataclass
class SaturatingRewardConfig:
    """``edtorch.rewards.SaturatingReward``: widths and targets by names of components, physical
    units."""

    _target_: str = "edtorch.rewards.SaturatingReward"
    width: dict[str, float] = field(default_factory=dict)
    target: dict[str, Any] = field(default_factory=dict)


@dataclass
class GradientFitConfig:
    """``edtorch.model.fit_gradient.GradientFit``."""

    _target_: str = MISSING
    rate: float = 0.01
    recent: int = 200
    steps: int = 1


@dataclass
class NoiseConfig:
    """exploration: scaled standard deviation; exploration_start: that of a newborn learner, null:
    the same; exploration_decay: seconds in which the difference falls by e; rate: of nu~ (where
    covariance is propagated)."""

    _target_: str = MISSING
    exploration: float = 0.05
    exploration_start: float | None = None
    exploration_decay: float | None = 0.3
    rate: float = 1.0


@dataclass
class TransformConfig:
    """A transform of ``edtorch.transform``."""

    _target_: str = MISSING


@dataclass
class GaussHermiteConfig(TransformConfig):
    """``edtorch.transform.GaussHermite``."""

    order: int = 3


@dataclass
class MonteCarloConfig(TransformConfig):
    """``edtorch.transform.MonteCarlo``."""

    samples: int = 200


@dataclass
class UnrollConfig:
    """horizon: steps; dt: seconds a step (derivative form); discount: per second, or per step;
    start: state, of the moment, or origin; start_deviation: scaled standard deviation of the belief
    that it starts from; direction: gradient, regulator or equilibrium (Riccati's, with step=full;
    the latter with the settings ``equilibrium``); path: auto,
    closed_form or generic; reading: figure or definition, see ``edtorch.value.unroll.Horizon``."""

    horizon: int = 30
    dt: float = 0.051
    discount: float = 1.0
    start: str = "state"
    start_deviation: float = 0.0
    direction: str = "gradient"
    equilibrium: dict[str, float] = field(default_factory=dict)
    path: str = "auto"
    reading: str = "figure"


@dataclass
class ScheduleConfig:
    """first: tick of the first improvement of the policy; often: seconds up to which every tick
    improves it; every: ticks from one improvement to the next after that.  null: chosen for the
    size of the model, see ``edtorch.learner.schedule.schedule_for``."""

    first: int | None = 1
    often: float | None = 0.0
    every: int = 1


@dataclass
class ObservationConfig:
    """What the learner knows of how it observes.

    unwrap: rad beyond half a turn up to which angles are counted on; null: always wrapped; delay:
    ticks that observations are late; noise: standard deviations of their errors by name of the
    component, in its unit, for fit=filtered.
    """

    unwrap: float | None = None
    delay: int = 0
    noise: dict[str, float] = field(default_factory=dict)


@dataclass
class FreeCommandConfig:
    """Model and policy see all of the state."""

    variant: str = "free"


@dataclass
class RampConfig:
    """variant: ramp or safe; component: of the state, by name; start, final: its bound for a
    newborn learner and later, in its unit; decay: seconds; see ``edtorch.learner.limit``."""

    variant: str = MISSING
    component: str = MISSING
    start: float = 0.25
    final: float = 1.0
    decay: float = 3.0


@dataclass
class SafeConfig(RampConfig):
    """share_start, share: of the limits that a command may use up, for a newborn learner and
    later; deviations: standard deviations to keep off; actions: whether the bounds of the actions
    are kept as well; horizon: steps predicted; dt: seconds a step."""

    share_start: float = 0.05
    share: float = 0.95
    deviations: float = 0.0
    actions: bool = False
    horizon: int = 45
    dt: float = 0.051


@dataclass
class FullStepConfig:
    """``edtorch.policy.steps.FullStep``."""

    _target_: str = MISSING


@dataclass
class SaturatedStepConfig:
    """``edtorch.policy.steps.SaturatedStep``."""

    _target_: str = MISSING
    alpha: float = MISSING
    beta: float = MISSING


@dataclass
class DecayingStepConfig(SaturatedStepConfig):
    """``edtorch.policy.steps.DecayingStep``."""

    decay: float = MISSING


@dataclass
class PlainStepConfig:
    """``edtorch.policy.steps.PlainStep``."""

    _target_: str = MISSING
    alpha: float = MISSING


@dataclass
class RivalConfig:
    """What searches instead of the learner; null: the learner."""

    _target_: str | None = None


@dataclass
class RandomSearchConfig(RivalConfig):
    """``edtorch.rivals.random_search.RandomSearch``; processes: of this many cores, null: all that
    this process may use."""

    policies: int = 100_000
    runs: int = 30
    low: float = -2.0
    high: float = 2.0
    slots: int = 1024
    look: int = 128
    processes: int | None = None


def settings_schema(settings: type) -> type:
    """The schema of a rival's settings, which are a dataclass and say the defaults themselves."""
    hints = get_type_hints(settings)
    own = [(f.name, hints[f.name], _default(f)) for f in fields(settings)]
    return make_dataclass(f"{settings.__name__}Config", own, bases=(RivalConfig,))


def _default(setting: Field[Any]) -> Any:
    if setting.default_factory is not DATACLASS_MISSING:
        return field(default_factory=setting.default_factory)
    return field(default=MISSING if setting.default is DATACLASS_MISSING else setting.default)


RIVALS: dict[str, type] = {
    "adaptive_lqr": AdaptiveLqr,
    "fitted_q": FittedQ,
    "lqr": Lqr,
    "lspi": Lspi,
    "pegasus": Pegasus,
    "ppo": PPO,
    "reinforce": Reinforce,
    "sac": SAC,
    "sarsa": Sarsa,
}
"""Rivals with a search per seed: their options in ``conf/rival/``, and their settings."""


@dataclass
class NoOfflineConfig:
    """Learners live through their own experience."""

    variant: str = "none"


@dataclass
class RecordedConfig:
    """variant: recorded; data: a file, a run's folder, or a list of them; share, order, passes,
    within: see ``edtorch.run.offline.Lessons``, within by name; invalid: refuse or mask, see
    ``edtorch.run.transitions_file``; improve: whether policies are improved while the transitions
    pass, as the group schedule says; steps: improvements after that, at most; tolerance: share of
    a policy that its last step is smaller than."""

    variant: str = MISSING
    data: Any = MISSING
    share: str = "own"
    order: str = "recorded"
    passes: int = 1
    within: dict[str, float] = field(default_factory=dict)
    invalid: str = "refuse"
    improve: bool = False
    steps: int = 1000
    tolerance: float = 1e-6


@dataclass
class BudgetConfig:
    """Per learner, whichever ends first; null: unlimited.  until: of a rival, the milestone at
    which a seed is done as well, stable or goal (``edtorch.report.milestones``)."""

    seconds: float | None = None
    episodes: int | None = None
    rides: int | None = None
    until: str | None = None


@dataclass
class EvalConfig:
    """episodes: fresh ones per seed after training; 0: none; keep: further ones, by which the best
    policy so far is kept; 0: the last policy is; minutes: simulated ones after which there are as
    many on the way; domain: settings of the domain that are others meanwhile; success_return: the
    return from which an episode is a success, null for what the domain says of success."""

    episodes: int = 100
    keep: int = 0
    minutes: list[float] = field(default_factory=list)
    domain: dict[str, Any] = field(default_factory=dict)
    success_return: float | None = None


@dataclass
class ComputeConfig:
    """precision: auto, float64 or mixed (learner float32, sim float64); threads: of torch in this
    process; compile: auto, on or off; compile_after: ticks before learning goes on compiled;
    device: cpu or cuda."""

    precision: str = "auto"
    threads: int = 1
    compile: str = "auto"
    compile_after: int = 500
    device: str = "cpu"


@dataclass
class LogConfig:
    """every: simulated seconds between two rows; checkpoint: between two saves of everything;
    value_error: whether the rows have the value error estimate; transitions: whether every one is
    kept, for ``transitions.npz``."""

    every: int = 5
    value_error: bool = False
    transitions: bool = False
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
    inverse: Any = None  # as in the runs of before there was such a group: none
    reward: Any = MISSING
    noise: Any = MISSING
    transform: Any = MISSING
    unroll: UnrollConfig = field(default_factory=UnrollConfig)
    schedule: ScheduleConfig = field(default_factory=ScheduleConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    command: Any = None  # as in the runs of before there was such a group: free
    step: Any = MISSING
    rival: Any = None  # as in the runs of before there was such a group: none
    offline: Any = None  # as in the runs of before there was such a group: none
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
    settings that replace the run's own; baselines: whether to evaluate the domain's own controllers
    in the same episodes; yardsticks: its name before 0.1.0.
    """

    run: str = MISSING
    policy: str | None = None
    episodes: int = 100
    domain: dict[str, Any] = field(default_factory=dict)
    baselines: bool = False
    yardsticks: bool = False
    threads: int = 1
    debug: bool = False


SCALARS = frozenset(f.name for f in fields(TrainConfig) if f.type in ("int", "bool"))
"""Settings of ``edtorch-train`` outside of any group."""

BEFORE: dict[str, type] = {
    "inverse": NoInverseConfig,
    "command": FreeCommandConfig,
    "rival": RivalConfig,
    "offline": NoOfflineConfig,
}
"""Groups that came later, and the option that the runs of before had in effect."""

SCHEMAS: dict[str, dict[str, type]] = {
    "domain": {
        "bicycle_schema": BicycleConfig,
        "slalom_schema": SlalomConfig,
        "sensed_schema": SensedConfig,
        "cardea_schema": CardeaConfig,
        "linear_schema": LinearSystemConfig,
        "gymnasium_schema": GymnasiumConfig,
    },
    "model": {"model_schema": ModelConfig},
    "fit": {
        "rate_schema": RateFitConfig,
        "normalised_schema": NormalisedFitConfig,
        "least_squares_schema": LeastSquaresConfig,
        "filtered_schema": FilteredConfig,
        "adaptive_schema": AdaptiveConfig,
        "bayesian_schema": BayesianFitConfig,
        "ridge_schema": RidgeConfig,
        "decaying_fit_schema": DecayingFitConfig,
        "gradient_schema": GradientFitConfig,
    },
    "inverse": {
        "none_schema": NoInverseConfig,
        "learned_schema": InverseConfig,
        "kinematic_schema": KinematicConfig,
    },
    "noise": {"noise_schema": NoiseConfig},
    "policy": {"policy_schema": PolicyConfig},
    "reward": {
        "quadratic_schema": RewardConfig,
        "saturating_schema": SaturatingRewardConfig,
    },
    "transform": {
        "transform_schema": TransformConfig,
        "gauss_hermite_schema": GaussHermiteConfig,
        "monte_carlo_schema": MonteCarloConfig,
    },
    "step": {
        "saturated_schema": SaturatedStepConfig,
        "decaying_schema": DecayingStepConfig,
        "plain_schema": PlainStepConfig,
        "full_schema": FullStepConfig,
    },
    "command": {
        "free_schema": FreeCommandConfig,
        "ramp_schema": RampConfig,
        "safe_schema": SafeConfig,
    },
    "offline": {"none_schema": NoOfflineConfig, "recorded_schema": RecordedConfig},
    "rival": {
        "rival_schema": RivalConfig,
        "random_search_schema": RandomSearchConfig,
        **{f"{name}_schema": settings_schema(settings) for name, settings in RIVALS.items()},
    },
}


def register() -> None:
    """Make the schemas of ``edtorch-train`` known to Hydra."""
    store = ConfigStore.instance()
    store.store(name="train_schema", node=TrainConfig)
    for group, options in SCHEMAS.items():
        for name, node in options.items():
            store.store(group=group, name=name, node=node)


def register_evaluation() -> None:
    """Make the schema of ``edtorch-eval`` known to Hydra.

    Without the groups of ``edtorch-train``: there ``policy=...`` would name one of them.
    """
    ConfigStore.instance().store(name="evaluate_schema", node=EvaluateConfig)
