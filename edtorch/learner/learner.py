"""One tick of learning as a pure function (Fig. 1).

``Learner.step(state, transition) -> (state, metrics)`` does no I/O, reads no globals and never asks
a tensor for its number; trouble comes back as flags.  That one property gives populations, exact
resumption and tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

import torch
from torch import Tensor

from edtorch.learner.annealing import Annealed
from edtorch.learner.estimator import AnyFit, Estimator, estimator_of
from edtorch.learner.limit import CommandLimit
from edtorch.learner.observer import Observer
from edtorch.model.models import Model
from edtorch.model.noise import Noise
from edtorch.policy.policies import Policy, explore
from edtorch.policy.steps import Step, gradient_norm
from edtorch.shapes import Actions, States
from edtorch.types import LearnerState, Metrics, Parameters, Transition, replace, select
from edtorch.value.unroll import ValuePath


class Check(IntEnum):
    """The places where a tick can break, in order: rows of ``Metrics.finite``.

    Where one does, the update concerned is skipped and the learner keeps what it knew.
    """

    TRANSITION = 0
    """The next state is finite; if not, the simulator broke."""
    FIT = 1
    """So are model and noise after the fit; if not, a rate is too high for these features."""
    UNROLL = 2
    """So are value and gradient; if not, the model under this policy explodes over the horizon."""


class Actor(Protocol):
    """What acts: a policy, or a policy and the model that carries out its wishes."""

    def action(self, parameters: Parameters, observation: Tensor, /) -> Tensor:
        """The action ``[*batch, m]`` for observations ``[*batch, n]``, both scaled."""
        ...


class AnyLearner(Protocol):
    """What a loop needs of a population of learners, whatever they learn."""

    @property
    def policy(self) -> Actor:
        """What acts."""
        ...

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        ...

    @property
    def observer(self) -> Observer | None:
        """What estimates the state from observations, None where they are taken for it."""
        ...

    def initial(self, seeds: Sequence[int]) -> LearnerState:
        """Learners that know nothing yet, one per seed."""
        ...

    def begin(self, state: LearnerState, fresh: Tensor, observation: Tensor) -> LearnerState:
        """At the beginning of new episodes of those that are ``fresh`` ``[B]``; observation
        ``[B, n]``: the first ones."""
        ...

    def acting(self, state: LearnerState) -> Parameters:
        """What ``policy.action`` needs of a state."""
        ...

    def act(self, state: LearnerState, observation: Tensor, normal: Tensor) -> Tensor:
        """The action with exploration, ``[B, m]``, scaled; normal ``[B, m]`` standard normal."""
        ...

    def step(
        self, state: LearnerState, transition: Transition, *, improve: bool = True
    ) -> tuple[LearnerState, Metrics]:
        """What is learned from one transition of each learner; of the model alone unless
        ``improve``."""
        ...


def _finite(total: Tensor, *more: Tensor) -> Tensor:
    """Whether every number of a learner is finite, ``[B]``; tensors ``[B, ...]``."""
    # A sum is finite only if all of its terms are (or it overflows, which is trouble as well).
    parts = [t.sum(tuple(range(1, t.ndim))) if t.ndim > 1 else t for t in (total, *more)]
    total = sum(parts[1:], parts[0])
    # inf - inf and nan - nan are nan: half the operations of isfinite.
    return (total - total) == 0


def _where(mask: Tensor, yes: Parameters, no: Parameters) -> Parameters:
    """``yes`` where ``mask`` ``[B]``, else ``no``; parameters ``[B, ...]`` of equal names."""
    return {name: select(mask, yes[name], no[name]) for name in no}


@dataclass(frozen=True)
class Learner:
    """A population of learners with one configuration; what they know is in a ``LearnerState``.

    exploration: standard deviation of the Gaussian added to the policy's action, scaled units, or
    that as a function of the age; noise: rule for nu~, None where nothing uses it; command: rule
    for what model and policy see of an observation, None for all of it; observer: what makes an
    estimate of the state of observations that are late or err, None where they are the state.  A
    fit that is a filter needs one with the same filter.
    """

    model: Model
    policy: Policy
    fit: AnyFit
    noise: Noise | None
    value: ValuePath
    step_rule: Step
    exploration: float | Annealed
    command: CommandLimit | None = None
    observer: Observer | None = None
    estimator: Estimator = field(init=False)

    def __post_init__(self) -> None:
        estimator = estimator_of(self.fit, self.model, self.observer)
        object.__setattr__(self, "estimator", estimator)
        given = self.exploration
        least = min(given.start, given.final) if isinstance(given, Annealed) else given
        if not least >= 0:
            raise ValueError(f"exploration={least}: expected a number >= 0")

    def initial(self, seeds: Sequence[int]) -> LearnerState:
        """Learners that know nothing yet, one per seed."""
        size = len(seeds)
        model, policy = self.model.initial(seeds), self.policy.initial(seeds)
        zeros, device = self.model.period.new_zeros, self.model.period.device
        noise: Parameters = {}
        if self.noise is not None:
            noise = self.noise.initial(zeros(size, self.model.states, self.model.regressors))
        tick = torch.zeros(size, dtype=torch.int64, device=device)
        observer: Parameters = {}
        if self.observer is not None:
            observer = self.observer.initial(zeros(size, self.model.states))
        return LearnerState(
            model=model,
            policy=policy,
            fit=self.estimator.initial(model),
            noise=noise,
            limit=self._limit(model, policy, noise, tick),
            step=self.step_rule.initial(policy),
            seed=torch.tensor(list(seeds), dtype=torch.int64, device=device),
            tick=tick,
            sound_ticks=torch.zeros(size, dtype=torch.int64, device=device),
            observer=observer,
        )

    def begin(self, state: LearnerState, fresh: Tensor, observation: Tensor) -> LearnerState:
        """New episodes for those that are ``fresh`` ``[B]``, from observations ``[B, n]``."""
        if self.observer is None:
            return state
        return replace(
            state,
            observer=self.observer.begin(state.observer, fresh, observation),
            fit=self.estimator.begin(state.fit, fresh),
        )

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        return self.value.needs_autograd or self.estimator.needs_autograd

    @property
    def dt_per_learner(self) -> bool:
        """Whether ``step`` takes transitions whose dt is ``[B]``: whether all parts do that use
        it."""
        parts = [self.model, self.fit, self.step_rule]
        parts += [] if self.noise is None else [self.noise]
        return all(getattr(part, "dt_per_learner", False) for part in parts)

    def _limit(
        self, model: Parameters, policy: Parameters, noise: Parameters, ticks: Tensor
    ) -> Parameters:
        """What bounds an observation, by the name under which a policy knows it."""
        if self.command is None:
            return {}
        return {"limit": self.command(model, policy, noise, ticks)}

    def acting(self, state: LearnerState) -> Parameters:
        """What ``policy.action`` needs of a state, and what an observer does."""
        if self.observer is None:
            return state.policy | state.limit
        return state.policy | state.limit | {"model": state.model["weight"]}

    def act(self, state: LearnerState, observation: States, normal: Actions) -> Actions:
        """pi(s) plus exploration, ``[B, m]`` in scaled units; normal ``[B, m]`` standard normal."""
        deviation = self.exploration
        if isinstance(deviation, Annealed):
            deviation = deviation(state.tick, observation.dtype).unsqueeze(-1)
        parameters = self.acting(state)
        if self.observer is not None:
            observation = self.observer.now(parameters, state.observer, observation)
        return explore(self.policy.action(parameters, observation), normal, deviation)

    def step(
        self, state: LearnerState, transition: Transition, *, improve: bool = True
    ) -> tuple[LearnerState, Metrics]:
        """Steps 1-7 of Fig. 1 after one transition of each learner; 1 and 2 unless ``improve``.

        Learners whose transition is not ``valid`` are left as they are.  An update that would not
        be finite is skipped: see ``Check``.
        """
        unit = self.model.time_unit(transition.dt)
        sound = _finite(transition.next_state)
        if self.observer is not None:
            transition, observer = self.observer.paired(state.observer, transition)
            state = replace(state, observer=observer)

        # 1, 2: the model and its noise.
        lesson = self.estimator.learn(state, transition, unit)
        noise = state.noise
        if self.noise is not None:
            squared = self.model.residual_noise(lesson.residual, transition.dt)
            noise = self.noise.update(noise, squared, lesson.phi, state.fit, unit)
        fit_ok = _finite(
            *lesson.parameters.values(),
            *lesson.memory.values(),
            *noise.values(),
            *lesson.observer.values(),
        )
        learn = transition.valid & fit_ok
        unbroken = fit_ok & (state.sound_ticks == state.tick) & transition.valid
        learned = replace(
            state,
            model=_where(learn, lesson.parameters, state.model),
            fit=_where(learn, lesson.memory, state.fit),
            noise=_where(learn, noise, state.noise),
            tick=state.tick + transition.valid,
            observer=_where(learn, lesson.observer, state.observer),
        )
        error = lesson.residual.abs().mean(-1)
        if not improve:
            learned = replace(learned, sound_ticks=state.sound_ticks + unbroken)
            finite = torch.stack([sound, fit_ok, torch.ones_like(sound)])
            return learned, Metrics(None, None, error, finite, None)

        # 3-6: value and gradient from where the transition ended; 7: the policy.
        known = learned.model | self.estimator.describe(learned.fit)
        here = self.value(known, state.policy, learned.noise, lesson.end)
        size = gradient_norm(here.gradient)
        value_ok = torch.isfinite(here.value + size)
        policy, step = self.step_rule(state.policy, here.gradient, state.step, unit)
        climb = transition.valid & value_ok
        learned = replace(
            learned,
            policy=_where(climb, policy, state.policy),
            step=_where(climb, step, state.step),
            # The count of sound ticks stands still from the first tick that was not.
            sound_ticks=state.sound_ticks + (unbroken & value_ok),
        )
        limit = self._limit(learned.model, learned.policy, learned.noise, learned.tick)
        learned = replace(learned, limit=_where(transition.valid, limit, state.limit))
        finite = torch.stack([sound, fit_ok, value_ok])
        return learned, Metrics(here.value, size, error, finite, here.first_floored)
