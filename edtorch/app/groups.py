"""The groups whose options name no class: their settings, types and defaults.

Settings of an option with a ``_target_`` are the arguments of that constructor instead; see
``edtorch.app.schema``.  Values are checked where they are used, by arguments of the same names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


def _empty() -> Any:
    return field(default_factory=dict)


@dataclass(frozen=True)
class Whole:
    """Settings outside of any group."""

    seed: int = 0
    seeds: int = 8
    debug: bool = False


@dataclass(frozen=True)
class RewardGroup:
    """``edtorch.rewards.QuadraticReward`` by names of components, physical units: minus weights of
    squared deviations of state and action from their target (a number, or another component), of
    products (cross: triples NAME, NAME, WEIGHT), of components themselves (linear), and of the
    squared distance from the goal, in a domain that has one; by_scale: components with a target and
    no weight, or all where none has either, weigh 1 / scale^2."""

    _target_: str = "edtorch.rewards.QuadraticReward"
    state: Mapping[str, float] = _empty()
    action: Mapping[str, float] = _empty()
    goal: float = 0.0
    target: Mapping[str, Any] = _empty()
    cross: Sequence[Any] = ()
    linear: Mapping[str, float] = _empty()
    by_scale: bool = False


@dataclass(frozen=True)
class ExplorationGroup:
    """deviation: scaled standard deviation of what is added to actions; start: that of a newborn
    learner, null: the same; decay: seconds in which the difference falls by e, null: chosen for the
    size of the model."""

    deviation: float = 0.05
    start: float | None = None
    decay: float | None = 0.3


@dataclass(frozen=True)
class UnrollGroup:
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
    equilibrium: Mapping[str, float] = _empty()
    path: str = "auto"
    reading: str = "figure"


@dataclass(frozen=True)
class ScheduleGroup:
    """first: tick of the first improvement of the policy; often: seconds up to which every tick
    improves it; every: ticks from one improvement to the next after that.  null: chosen for the
    size of the model, see ``edtorch.learner.schedule.schedule_for``."""

    first: int | None = 1
    often: float | None = 0.0
    every: int = 1


@dataclass(frozen=True)
class ObservationGroup:
    """What the learner knows of how it observes.

    unwrap: rad beyond half a turn up to which angles are counted on; null: always wrapped; delay:
    ticks that observations are late; noise: standard deviations of their errors by name of the
    component, in its unit, for fit=filtered.
    """

    unwrap: float | None = None
    delay: int = 0
    noise: Mapping[str, float] = _empty()


@dataclass(frozen=True)
class FreeGroup:
    """Model and policy see all of the state."""

    variant: str = "free"


@dataclass(frozen=True)
class RampGroup:
    """component: of the state, by name; start, final: its bound for a newborn learner and later,
    in its unit; decay: seconds; see ``edtorch.learner.limit``."""

    variant: str = "ramp"
    component: str = "angle_to_goal"
    start: float = 0.25
    final: float = 1.0
    decay: float = 3.0


@dataclass(frozen=True)
class SafeGroup(RampGroup):
    """share_start, share: of the limits that a command may use up, for a newborn learner and
    later; deviations: standard deviations to keep off; actions: whether the bounds of the actions
    are kept as well; horizon: steps predicted; dt: seconds a step."""

    variant: str = "safe"
    final: float = 3.14
    share_start: float = 0.05
    share: float = 0.95
    deviations: float = 0.0
    actions: bool = False
    horizon: int = 45
    dt: float = 0.051


@dataclass(frozen=True)
class NoInverseGroup:
    """A forward model and a policy of actions."""

    variant: str = "none"


@dataclass(frozen=True)
class InverseGroup:
    """features: name of those of the inverse model, or a ``_target_``; form, gain, limit: of the
    policy, see ``edtorch.inverse.policy.InversePolicy``; every, recent: see
    ``edtorch.inverse.learner.InverseLearner``; trust_acceleration, trust_speed: see its
    ``SampleWeight``."""

    variant: str = "learned"
    features: Any = "structured"
    form: str = "error"
    gain: float = 20.0
    limit: float | None = 30.0
    every: int = 5
    recent: int = 10
    trust_acceleration: float = 100.0
    trust_speed: float = 10.0


@dataclass(frozen=True)
class KinematicGroup(InverseGroup):
    """Also length, damping and bent: see ``edtorch.inverse.hand.HandCoordinates``."""

    variant: str = "kinematic"
    length: float = 0.15
    damping: float = 0.15
    bent: float = 0.15


@dataclass(frozen=True)
class NoOfflineGroup:
    """Learners live through their own experience."""

    variant: str = "none"


@dataclass(frozen=True)
class RecordedGroup:
    """data: a file, a run's folder, or a list of them; share, order, passes, within: see
    ``edtorch.run.offline.Lessons``, within by name; invalid: refuse or mask, see
    ``edtorch.run.transitions_file``; improve: whether policies are improved while the transitions
    pass, as the group schedule says; steps: improvements after that, at most; tolerance: share of
    a policy that its last step is smaller than."""

    variant: str = "recorded"
    data: Any = None
    share: str = "own"
    order: str = "recorded"
    passes: int = 1
    within: Mapping[str, float] = _empty()
    invalid: str = "refuse"
    improve: bool = False
    steps: int = 1000
    tolerance: float = 1e-6


@dataclass(frozen=True)
class NoRivalGroup:
    """The learner, and nothing that searches instead."""

    _target_: str | None = None


@dataclass(frozen=True)
class OnlineGroup:
    """The learner improves its policy at its ticks, and no search between trials does."""

    _target_: str | None = None


@dataclass(frozen=True)
class ToldGroup:
    """Prior knowledge of the state's components by name, in addition to the domain's, for a search
    between trials: see ``edtorch.model.told.Told``, ``edtorch.model.stops.Stops`` and
    ``edtorch.model.strike.Strike``."""

    angles: Sequence[str] = ()
    rates: Mapping[str, str] = _empty()
    constant: Sequence[str] = ()
    ignored: Sequence[str] = ()
    invariant: Sequence[str] = ()
    stops: Mapping[str, Any] | None = None
    strike: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class TrainGroup:
    """Per learner, whichever ends first; null: unlimited.  until: of a rival, the milestone at
    which a seed is done as well, stable or goal (``edtorch.run.milestones``)."""

    seconds: float | None = None
    episodes: int | None = None
    successes: int | None = None
    until: str | None = None


@dataclass(frozen=True)
class EvalGroup:
    """episodes: fresh ones per seed after training; 0: none; keep: further ones, by which the best
    policy so far is kept; 0: the last policy is; minutes: simulated ones after which there are as
    many on the way; domain: settings of the domain that are others meanwhile; success_return: the
    return from which an episode is a success, null for what the domain says of success."""

    episodes: int = 100
    keep: int = 0
    minutes: Sequence[float] = ()
    domain: Mapping[str, Any] = _empty()
    success_return: float | None = None
    solved: Mapping[str, Any] = _empty()


@dataclass(frozen=True)
class ComputeGroup:
    """native: auto, on or off (``edtorch.native``); threads: of torch in this process, and of
    kernels; device: cpu or cuda."""

    native: str = "auto"
    threads: int = 1
    device: str = "cpu"


@dataclass(frozen=True)
class LogGroup:
    """every: simulated seconds between two rows; checkpoint_wall: wall seconds between two saves of
    everything, 0 for as often as it can; checkpoints: how many of the last ones are kept;
    value_error: whether the rows have the value error estimate; transitions: whether every one is
    kept, for ``transitions.npz``."""

    every: int = 5
    value_error: bool = False
    transitions: bool = False
    checkpoint_wall: float = 60.0
    checkpoints: int = 2
    tensorboard: bool = True
    figures: bool = True
    animation: bool = True
    progress: bool = True


@dataclass(frozen=True)
class SweepGroup:
    """Of ``edtorch-train -m``.  name: of a sweep that can be repeated, null: it has a folder by the
    time of day; retry: whether jobs that have failed are tried again."""

    name: str | None = None
    retry: bool = False


@dataclass(frozen=True)
class Evaluate:
    """Settings of ``edtorch-eval``.

    run: folder of a run; policy: a file, by default the run's own; episodes: per seed; domain:
    settings that replace the run's own; baselines: whether to evaluate the domain's own controllers
    in the same episodes; yardsticks: its name before 0.1.0; native: auto, on or off
    (``edtorch.native.evaluation``); threads: as in training; trust: names of packages whose code
    the run's configuration may import, or true (``edtorch.app.trust``).
    """

    run: str
    policy: str | None = None
    episodes: int = 100
    domain: Mapping[str, Any] = _empty()
    baselines: bool = False
    yardsticks: bool = False
    native: str = "auto"
    threads: int = 1
    trust: Any = ()
    debug: bool = False


TARGETED = ("domain", "model", "fit", "policy", "noise", "transform", "step")
"""Groups whose options all name a class."""

UNTARGETED: dict[str, tuple[type, ...]] = {
    "inverse": (NoInverseGroup, InverseGroup, KinematicGroup),
    "reward": (RewardGroup,),
    "exploration": (ExplorationGroup,),
    "unroll": (UnrollGroup,),
    "schedule": (ScheduleGroup,),
    "observation": (ObservationGroup,),
    "command": (FreeGroup, RampGroup, SafeGroup),
    "rival": (NoRivalGroup,),
    "search": (OnlineGroup,),
    "told": (ToldGroup,),
    "offline": (NoOfflineGroup, RecordedGroup),
    "train": (TrainGroup,),
    "eval": (EvalGroup,),
    "compute": (ComputeGroup,),
    "log": (LogGroup,),
    "sweep": (SweepGroup,),
}
"""By group, the variants of what an option without a class sets; the first where none is given."""

GROUPS = (*TARGETED, *UNTARGETED)
"""All of them."""
