"""What of a learner and its world a kernel needs to know, and whether there is a kernel for it.

Sizes and kinds of parts are constants of the program; rates, costs and bounds are numbers that it
is given, so that a sweep over them compiles nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from edtorch.learner.annealing import Annealed
from edtorch.learner.learner import Learner
from edtorch.learner.limit import Ramp, Safe
from edtorch.model.fit import (
    AbsoluteError,
    NormalisedSquaredError,
    RecursiveLeastSquares,
    SquaredError,
)
from edtorch.model.fit_adaptive import AdaptiveLeastSquares
from edtorch.model.fit_decaying import DecayingFit
from edtorch.model.models import DerivativeModel, NextStateModel, dynamics_of
from edtorch.model.noise import ResidualNoise
from edtorch.native.layout import RowLayout
from edtorch.policy.policies import CentredPolicy, LinearPolicy, gain_of
from edtorch.policy.steps import DecayingStep, FullStep, PlainStep, SaturatedStep
from edtorch.rewards import quadratic_form_of
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Population, Source, Tick
from edtorch.types import LearnerState
from edtorch.value.linear import LinearMeanOnly, LinearMoment
from edtorch.value.linear.regulator import Regulator
from edtorch.value.unroll import FromOrigin
from sims.base import Actuated, Judged, Losing, Rewarded
from sims.rows import NoRows, Rows, rows_of

_NEVER = 2.0**52
"""A count that is never reached."""


class NoKernel(Exception):
    """A part has no compiled form; the message is that part, in words for the log."""


@dataclass
class KernelPlan:
    """constants: of the program, by name; chosen: names of its functions by role; texts: functions
    that belong to this program only; numbers: what kernels are given, by name; rows: the simulator,
    None for a world that is not compiled."""

    constants: dict[str, int] = field(default_factory=dict)
    chosen: dict[str, str] = field(default_factory=dict)
    texts: list[str] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    rows: Rows | None = None

    def number(self) -> tuple[dict[str, int], np.ndarray[Any, Any]]:
        """Where each of ``numbers`` begins in one array, and that array."""
        places, found = {}, []
        # The one whose length is not a size of the program is the last.
        for name, value in sorted(self.numbers.items(), key=lambda item: item[0] == "WEIGHTS"):
            places[name] = sum(map(len, found))
            flat = torch.as_tensor(value, dtype=torch.float64).detach().reshape(-1).numpy()
            # What is not used has a place all the same.
            found.append(flat if len(flat) else np.zeros(1))
        return places, np.concatenate(found)


_KEPT = {
    "WEIGHT": "learners.model.weight",
    "THETA": "learners.policy.weight",
    "FIT_P": "learners.fit.P",
    "SHORT": "learners.fit.short",
    "LONG": "learners.fit.long",
    "HEARD": "learners.fit.heard",
    "ALARMS": "learners.fit.alarms",
    "LEARNED": "learners.fit.learned",
    "NU": "learners.noise.nu",
    "LIMIT": "learners.limit.limit",
    "CLIMBED": "learners.step.climbed",
    "WORLD": "worlds.world",
    "START": "worlds.start",
    "OBSERVATION": "worlds.observation",
    "EARNED": "worlds.earned",
    "TALLY_VALUE": "tally.value",
    "TALLY_GRADIENT": "tally.gradient",
    "TALLY_UPDATES": "tally.updates",
    "TALLY_ERROR": "tally.error",
    "TALLY_TICKS": "tally.ticks",
    "AGE": "learners.tick",
    "SOUND_TICKS": "learners.sound_ticks",
    "BEGUN": "worlds.begun",
    "ACTIVE": "worlds.active",
    "EPISODES": "worlds.episodes",
    "FAILURES": "worlds.failures",
    "SUCCESSES": "worlds.successes",
    "FINITE": "tally.finite",
}
"""Rows that the kernels name, by the leaf of a population that they hold."""


def plan_of(tick: Tick[LearnerState], population: Population[LearnerState]) -> KernelPlan:
    """The plan for ticks like this one.  Raises NoKernel with the first part that has none."""
    layout = RowLayout.of(population)
    plan = learner_plan(tick.learner, tick.world, layout)
    plan.constants["WIDTH"] = layout.leaves["worlds.world"].shape[0]
    add_world(plan, tick.world)
    schedule, most = tick.schedule, (tick.most_episodes, tick.most_successes)
    plan.numbers |= {
        "IMPROVE_FIRST": schedule.first,
        "OFTEN": schedule.often,
        "EVERY": schedule.every,
        "MOST_EPISODES": _NEVER if most[0] is None else most[0],
        "MOST_SUCCESSES": _NEVER if most[1] is None else most[1],
        "STRIDE": 1,
    }
    return plan


def learner_plan(learner: Source[LearnerState], world: World, layout: RowLayout) -> KernelPlan:
    """The part of a plan that is the learner's, with what it sees and does in the units of
    ``World``.  Raises NoKernel."""
    if type(learner) is not Learner:
        raise NoKernel("the inverse model")
    plan = begun(world)
    # The kinds first: the rows are those of parts that have kernels.
    _learner(plan, learner, world)
    _places(plan, layout)
    _scratch(plan)
    return plan


def begun(world: World) -> KernelPlan:
    """What every plan for this world begins with.  Raises NoKernel."""
    if world.dtype != torch.float64 or world.device.type != "cpu":
        raise NoKernel(f"{world.dtype} on {world.device.type}")
    spec = world.spec
    plan = KernelPlan(constants={"CLIPS": int(spec.clip_action), "UNWRAPS": 0})
    plan.numbers |= {
        "TICK": world.seconds,
        "STATE_SCALE": [1.0] * len(spec.state),
        "ACTION_SCALE": [1.0] * len(spec.action),
        "LOW": [q.low / q.scale for q in spec.action],
        "HIGH": [q.high / q.scale for q in spec.action],
    }
    return plan


def add_units(plan: KernelPlan, world: World) -> None:
    """From physical units to those of ``World``, angles counted on."""
    plan.constants["UNWRAPS"] = int(world.unwraps)
    plan.numbers |= {
        "STATE_SCALE": [q.scale for q in world.spec.state],
        "ACTION_SCALE": [q.scale for q in world.spec.action],
        "UNWRAP_TURNS": world.turns,
        "UNWRAP_PERIOD": world.period,
        "FARTHEST": world.farthest,
    }


def _places(plan: KernelPlan, layout: RowLayout) -> None:
    for name, leaf in _KEPT.items():
        plan.constants[name] = layout.leaves[leaf].row if leaf in layout.leaves else 0
    known = [
        name for name in layout.leaves if name.startswith(("learners.fit.", "learners.noise."))
    ]
    last = max((layout.leaves[name].rows.stop for name in known), default=0)
    plan.constants["KNOWN"] = max(last, layout.leaves["learners.model.weight"].rows.stop)
    plan.constants |= {"KEPT": layout.numbers, "COUNTERS": layout.counters}


def _learner(plan: KernelPlan, learner: Learner, world: World) -> None:
    if learner.observer is not None:
        raise NoKernel("estimates of the state")
    model = learner.model
    if type(model) not in (DerivativeModel, NextStateModel):
        raise NoKernel(f"a model of the kind {type(model).__name__}")
    dynamics = dynamics_of(model, model.initial([0]), 1.0)
    if dynamics is None:
        raise NoKernel("a model that is not linear in state and action")
    add_policy(plan, learner.policy)
    path, origin = learner.value, None
    from_origin = type(path) is FromOrigin
    if isinstance(path, FromOrigin):
        path, origin = path.path, path.origin
    n, m = model.states, model.actions
    affine = getattr(path, "augmented", False)
    affine = affine or dynamics.constant is not None or plan.constants["POLICY_CONSTANT"] == 1
    plan.constants |= {
        "K": model.regressors,
        "A": n + affine,
        "AFFINE": int(affine),
        "MODEL_CONSTANT": int(dynamics.constant is not None),
        "INTEGRATES": int(model.integrates),
        "FROM_ORIGIN": int(from_origin),
    }
    plan.numbers |= {
        "UNIT": model.time_unit(world.seconds),
        "PERIOD": model.period,
        "TURNS": torch.where(model.period > 0, 1 / model.period, 0.0),
        "ORIGIN": torch.zeros(n) if origin is None else origin,
    }
    _fit(plan, learner.fit)
    if learner.noise is None:
        plan.constants["NOISY"] = 0
        plan.numbers["NOISE_RATE"] = 0.0
    elif type(learner.noise) is ResidualNoise:
        plan.constants["NOISY"] = 1
        plan.numbers["NOISE_RATE"] = learner.noise.rate
    else:
        raise NoKernel(f"noise of the kind {type(learner.noise).__name__}")
    _value(plan, path, n, m)
    _step(plan, learner.step_rule)
    given = learner.exploration
    annealed = given if isinstance(given, Annealed) else Annealed(given, given, 1.0)
    plan.constants["ANNEALED"] = int(isinstance(given, Annealed))
    plan.constants["EXPLORES"] = 1
    plan.numbers["DEVIATION"] = [annealed.start, annealed.final, annealed.decay]
    _command(plan, learner)


def add_policy(plan: KernelPlan, policy: Any) -> None:
    """Sizes and kind of a policy.  Raises NoKernel unless it is linear in the state."""
    is_plain = type(policy) in (LinearPolicy, CentredPolicy)
    gain = gain_of(policy, policy.initial([0])) if is_plain else None
    if gain is None:
        raise NoKernel("a policy that is not linear in the state")
    plan.constants |= {
        "N": gain.state.shape[-1],
        "M": gain.state.shape[-2],
        "KP": policy.weight.shape[-1],
        "POLICY_CONSTANT": int(gain.constant is not None),
    }


def _fit(plan: KernelPlan, fit: Any) -> None:
    decay = 0.0
    plan.constants["DECAYING"] = int(type(fit) is DecayingFit)
    if type(fit) is DecayingFit:
        fit, decay = fit.rule, fit.decay
    kernels: Mapping[type, str] = {
        AbsoluteError: "absolute",
        SquaredError: "squared",
        NormalisedSquaredError: "normalised",
        RecursiveLeastSquares: "least_squares",
        AdaptiveLeastSquares: "adaptive",
    }
    memory_of_its_own = type(fit) in (RecursiveLeastSquares, AdaptiveLeastSquares)
    if type(fit) not in kernels or (plan.constants["DECAYING"] and memory_of_its_own):
        raise NoKernel(f"a fit of the kind {type(fit).__name__}")
    plan.chosen["fit"] = kernels[type(fit)]
    plan.numbers |= {
        "FIT_DECAY": decay,
        "FIT_RATE": getattr(fit, "rate", 0.0),
        "FIT_FLOOR": getattr(fit, "floor", 0.0),
        "FORGETTING": getattr(fit, "forgetting", 1.0),
        "FAST": getattr(fit, "fast", 1.0),
        "SLOW": getattr(fit, "slow", 1.0),
        "THRESHOLD": getattr(fit, "threshold", 1.0),
        "DOUBTED": getattr(fit, "doubt", 0.0),
    }


def _value(plan: KernelPlan, path: Any, n: int, m: int) -> None:
    kernels: Mapping[type, str] = {
        LinearMeanOnly: "mean_value",
        LinearMoment: "moment_value",
        Regulator: "regulator_value",
    }
    if type(path) not in kernels:
        raise NoKernel(f"a value of the kind {type(path).__name__}")
    plan.chosen["value"] = kernels[type(path)]
    is_regulator, size = type(path) is Regulator, plan.constants["A"]
    state, action, cross = path.state_cost, path.action_cost, path.cross
    priced = action is not None or cross is not None
    is_diagonal = bool((state == torch.diag(state.diagonal())).all())
    plan.constants |= {"PRICED_ACTIONS": int(priced), "DIAGONAL": int(is_diagonal)}
    plan.numbers |= {
        "UNROLL_TICK": path.horizon.dt if is_regulator else path.dt,
        "COST_UNIT": path.horizon.unit if is_regulator else 1.0,
        "DISCOUNT": path.horizon.discount**path.horizon.unit if is_regulator else 1.0,
        "STATE_COST": state,
        "ACTION_COST": torch.zeros(m, m) if action is None else action,
        "CROSS_COST": torch.zeros(size, m) if cross is None else cross,
        "START_COV": getattr(path, "start_cov", torch.zeros(n, n)),
        "STEPS": path.horizon.steps if is_regulator else len(path.weights),
        "WEIGHTS": [] if is_regulator else path.weights,
    }


def _step(plan: KernelPlan, rule: Any) -> None:
    kernels: Mapping[type, str] = {
        SaturatedStep: "saturated",
        DecayingStep: "saturated",
        PlainStep: "plain",
        FullStep: "full",
    }
    if type(rule) not in kernels:
        raise NoKernel(f"a step of the kind {type(rule).__name__}")
    plan.chosen["step"] = kernels[type(rule)]
    plan.constants["STEP_DECAYS"] = int(type(rule) is DecayingStep)
    plan.numbers |= {
        "ALPHA": getattr(rule, "alpha", 1.0),
        "BETA": getattr(rule, "beta", 1.0),
        "STEP_DECAY": getattr(rule, "decay", 1.0),
    }


def _command(plan: KernelPlan, learner: Learner) -> None:
    command = learner.command
    if type(command) not in (type(None), Ramp, Safe):
        raise NoKernel(f"a command of the kind {type(command).__name__}")
    safe = command if isinstance(command, Safe) else None
    ramp = safe.ramp if safe is not None else command
    assert ramp is None or isinstance(ramp, Ramp)
    plan.chosen["command"] = "safe" if safe is not None else "ramp"
    watched = safe is not None and safe.noise is not None and safe.deviations > 0
    limits = () if safe is None else tuple(safe.limits)
    actions = () if safe is None else tuple(safe.actions)
    share = Annealed(1.0, 1.0, 1.0) if safe is None else safe.share
    bound = Annealed(1.0, 1.0, 1.0) if ramp is None else ramp.bound
    plan.constants |= {
        "LIMITED": int(ramp is not None),
        "COMMANDED": 0 if ramp is None else ramp.index,
        "WATCHED": int(watched),
        "CONSTRAINED": len(limits),
        "BOUNDED": len(actions),
    }
    plan.numbers |= {
        "RAMP": [bound.start, bound.final, bound.decay],
        "SHARED": [share.start, share.final, share.decay],
        "SAFE_TICK": 0.0 if safe is None else safe.dt,
        "SAFE_STEPS": 0 if safe is None else safe.horizon,
        "DEVIATIONS": 0.0 if safe is None else safe.deviations,
        "CONSTRAINTS": [x for pair in limits for x in pair],
        "BOUNDED_ACTIONS": [x for pair in actions for x in pair],
    }


def add_world(plan: KernelPlan, world: World) -> None:
    """The simulator's rows, and what ``World`` adds to them.  Raises NoKernel."""
    sim: Any = world.sim
    for protocol, what in (
        (Rewarded, "a reward of the simulator's own"),
        (Judged, "a simulator that judges its episodes"),
        (Losing, "a simulator that loses episodes"),
        (Actuated, "a simulator that knows what its actuators did"),
    ):
        if isinstance(sim, protocol):
            raise NoKernel(what)
    offered = getattr(sim, "rows", None)
    if offered is None:
        raise NoKernel(f"the simulator {world.spec.name}, which is not written over rows")
    try:
        plan.rows = rows_of(sim)
    except NoRows as error:
        raise NoKernel(f"the simulator: {error}") from error
    n, m, spec = len(world.spec.state), len(world.spec.action), world.spec
    form = None if world.reward is None else quadratic_form_of(world.reward)
    if world.reward is not None and form is None:
        raise NoKernel("a return that is not quadratic")
    rule = world.rule
    add_units(plan, world)
    plan.constants |= {
        "EARNS": int(form is not None),
        "RETURN_DECIDES": int(rule.least_return is not None and world.has_return),
        "LATE_SUCCEEDS": int(rule.survival is not False),
        "DISTURBANCES": spec.disturbance_dim,
        "RESETS": spec.reset_dim,
    }
    plan.numbers |= {
        "LIMIT_TICKS": world.limit_ticks,
        "LEAST_RETURN": rule.least_return or 0.0,
        "RETURN_STATE": torch.zeros(n, n) if form is None else form.state,
        "RETURN_ACTION": torch.zeros(m, m) if form is None else form.action,
        "RETURN_CROSS": torch.zeros(n, m) if form is None else form.cross,
        "RETURN_LINEAR": torch.zeros(n + m)
        if form is None
        else torch.cat([form.state_linear, form.action_linear]),
        "RETURN_CONSTANT": 0.0 if form is None else form.constant,
    }


def place(plan: KernelPlan, widths: Mapping[str, int]) -> int:
    """Put rows of these widths one after the other under their names; how many there are."""
    rows = 0
    for name, width in widths.items():
        plan.constants[name] = rows
        rows += width
    return rows


def _scratch(plan: KernelPlan) -> None:
    """Places of the rows of scratch; and how many there are, SCRATCH, and those of the tape of an
    unroll for each of its steps, TAPE."""
    c = plan.constants
    n, m, k, a, kp = (c[name] for name in ("N", "M", "K", "A", "KP"))
    vectors = {"ACTION": m, "NORMAL": m, "NEXT": n, "END": n, "TARGET": n, "RESIDUAL": n, "PHI": k}
    vectors |= {"SIGN": n, "PROJECTED": k, "GAIN": k, "NEW": c["KNOWN"], "ADJOINT": a, "PULLED": a}
    matrices = {"GRADIENT": m * kp, "FULL": m * a, "GAINS": m * a, "PRICED": m * a, "INPUT": a * m}
    matrices |= {"PUSHED": a * m, "PIVOTS": m * m}
    squares = dict.fromkeys(("DRIFT", "COST", "THROUGH", "MOMENT", "X", "Y", "OVER_STEP"), a * a)
    flags = (
        "SOUND FIT_OK VALUE_OK ERROR VALUE NORM GO VALID LIVES UNBROKEN OUTCOME RATE DEVIATE DOUBT"
        " ALLOWED SHARE"
    ).split()
    c["SCRATCH"] = place(plan, vectors | matrices | squares | dict.fromkeys(flags, 1))
    c["TAPE"] = a * a if plan.chosen["value"] == "moment_value" else a
