"""One tick of learning as a pure function (Fig. 1).

``Learner.step(state, transition) -> (state, metrics)`` does no I/O, reads no globals and never asks
a tensor for its number; trouble comes back as flags.  That one property gives populations, exact
resumption and tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import torch
from torch import Tensor

from edtorch.annealing import Annealed
from edtorch.command import CommandLimit
from edtorch.fit import Fit
from edtorch.models import Model
from edtorch.noise import Noise
from edtorch.policies import LinearPolicy, bounded, explore
from edtorch.types import LearnerState, Metrics, Parameters, Transition, replace, select
from edtorch.unroll import ValuePath
from edtorch.update import Step, gradient_norm


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

    def initial(self, seeds: Sequence[int]) -> LearnerState:
        """Learners that know nothing yet, one per seed."""
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


def population(template: torch.nn.Module, size: int) -> Parameters:
    """The template's parameters, once for each of ``size`` learners."""
    return {
        name: p.detach().expand(size, *p.shape).clone() for name, p in template.named_parameters()
    }


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
    for what model and policy see of an observation, None for all of it.
    """

    model: Model
    policy: LinearPolicy
    fit: Fit
    noise: Noise | None
    value: ValuePath
    step_rule: Step
    exploration: float | Annealed
    command: CommandLimit | None = None

    def __post_init__(self) -> None:
        given = self.exploration
        least = min(given.start, given.final) if isinstance(given, Annealed) else given
        if not least >= 0:
            raise ValueError(f"exploration={least}: expected a number >= 0")

    def initial(self, seeds: Sequence[int]) -> LearnerState:
        """Learners that know nothing yet, one per seed."""
        size = len(seeds)
        model = population(self.model, size)
        device = model["weight"].device
        policy = population(self.policy, size)
        noise = {} if self.noise is None else self.noise.initial(model["weight"])
        tick = torch.zeros(size, dtype=torch.int64, device=device)
        return LearnerState(
            model=model,
            policy=policy,
            fit=self.fit.initial(model["weight"]),
            noise=noise,
            limit=self._limit(model, policy, noise, tick),
            step=self.step_rule.initial(policy),
            seed=torch.tensor(list(seeds), dtype=torch.int64, device=device),
            tick=tick,
            sound_ticks=torch.zeros(size, dtype=torch.int64, device=device),
        )

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        return self.value.needs_autograd

    def _limit(
        self, model: Parameters, policy: Parameters, noise: Parameters, ticks: Tensor
    ) -> Parameters:
        """What bounds an observation, by the name under which a policy knows it."""
        if self.command is None:
            return {}
        return {"limit": self.command(model, policy, noise, ticks)}

    def acting(self, state: LearnerState) -> Parameters:
        """What ``policy.action`` needs of a state."""
        return state.policy | state.limit

    def act(self, state: LearnerState, observation: Tensor, normal: Tensor) -> Tensor:
        """pi(s) plus exploration, ``[B, m]`` in scaled units; normal ``[B, m]`` standard normal."""
        deviation = self.exploration
        if isinstance(deviation, Annealed):
            deviation = deviation(state.tick, observation.dtype).unsqueeze(-1)
        return explore(self.policy.action(self.acting(state), observation), normal, deviation)

    def step(
        self, state: LearnerState, transition: Transition, *, improve: bool = True
    ) -> tuple[LearnerState, Metrics]:
        """Steps 1-7 of Fig. 1 after one transition of each learner; 1 and 2 unless ``improve``.

        Learners whose transition is not ``valid`` are left as they are.  An update that would not
        be finite is skipped: see ``Check``.
        """
        unit = self.model.time_unit(transition.dt)
        sound = _finite(transition.next_state)
        seen = self._seen(state, transition)

        # 1, 2: the model and its noise.
        target = self.model.target(seen)
        phi = self.model.regressor(seen)
        old = state.model["weight"]
        fitted = self.fit.update(old, state.fit, phi, target, unit)
        noise = state.noise
        if self.noise is not None:
            squared = self.model.residual_noise(fitted.residual, transition.dt)
            noise = self.noise.update(noise, squared, phi, state.fit, unit)
        fit_ok = _finite(fitted.weight, *fitted.memory.values(), *noise.values())
        learn = transition.valid & fit_ok
        unbroken = fit_ok & (state.sound_ticks == state.tick) & transition.valid
        learned = replace(
            state,
            model=state.model | {"weight": select(learn, fitted.weight, old)},
            fit=_where(learn, fitted.memory, state.fit),
            noise=_where(learn, noise, state.noise),
            tick=state.tick + transition.valid,
        )
        error = fitted.residual.abs().mean(-1)
        if not improve:
            learned = replace(learned, sound_ticks=state.sound_ticks + unbroken)
            finite = torch.stack([sound, fit_ok, torch.ones_like(sound)])
            return learned, Metrics(None, None, error, finite, None)

        # 3-6: value and gradient from where the transition ended; 7: the policy.
        here = self.value(learned.model, state.policy, learned.noise, seen.next_state)
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

    def _seen(self, state: LearnerState, transition: Transition) -> Transition:
        """The transition as the model sees it: as far as it went, from within the bounds."""
        if not state.limit:
            return transition
        start = bounded(transition.state, state.limit["limit"])
        end = start + self.model.displacement(transition)
        return replace(transition, state=start, next_state=end)
