"""Step 1 of Fig. 1 for every kind of fit: what one transition teaches about the model.

An ``Estimator`` binds a fit to the model it fits.  ``Regression`` is for rules of
``edtorch.model.fit``, which fit weights that act linearly on features; ``ByGradient`` for rules
that fit any parameters (``fits_parameters``); ``Filtering`` for those that estimate the state as
well (``estimates_state``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from edtorch.learner.filter import JointFilter
from edtorch.learner.observer import Observer, believed
from edtorch.model.fit import Fit
from edtorch.model.fit_gradient import ParameterFit
from edtorch.model.models import Model
from edtorch.policy.policies import bounded
from edtorch.types import LearnerState, Parameters, Transition, replace, select

AnyFit = Fit | ParameterFit | JointFilter
"""Whatever a learner's ``fit`` may be."""


@dataclass(frozen=True)
class Lesson:
    """What a transition taught: the model's parameters, the fit's memory, the residual ``[B, n]``
    of before, what nu~ knows of state and action (phi), where the transition ended as far as is
    known ``[B, n]``, and the observer's memory."""

    parameters: Parameters
    memory: Parameters
    residual: Tensor
    phi: Tensor
    end: Tensor
    observer: Parameters


class Estimator(Protocol):
    """A fit bound to its model."""

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        ...

    def initial(self, model: Parameters) -> Parameters:
        """The memory for model parameters ``[B, ...]``."""
        ...

    def begin(self, memory: Parameters, fresh: Tensor) -> Parameters:
        """The memory at the beginning of new episodes of those that are ``fresh`` ``[B]``."""
        ...

    def learn(self, state: LearnerState, transition: Transition, unit: Tensor) -> Lesson:
        """Step 1; unit: what a rate is multiplied with."""
        ...

    def describe(self, memory: Parameters) -> Parameters:
        """What value paths may use of the data beside the model's parameters, ``[B, ...]``."""
        ...


def estimator_of(fit: AnyFit, model: Model, observer: Observer | None) -> Estimator:
    """The estimator for what ``fit`` says of itself.

    ValueError for a rule for weights with a model that has none, and for a fit that estimates the
    state without an observer that has the same filter.
    """
    filters = observer is not None and observer.filter is not None
    if getattr(fit, "estimates_state", False) != filters:
        raise ValueError("observer: expected one with a filter where the fit is that filter")
    if filters:
        return Filtering(fit, observer)  # pyright: ignore[reportArgumentType]
    if getattr(fit, "fits_parameters", False):
        return ByGradient(fit, model)  # pyright: ignore[reportArgumentType]
    if not getattr(model, "linear_in_parameters", False):
        raise ValueError(
            f"fit={type(fit).__name__}: expected a rule that fits any parameters, fit=gradient,"
            " with a model that is not linear in features"
        )
    return Regression(fit, model)  # pyright: ignore[reportArgumentType]


def _seen(model: Model, state: LearnerState, transition: Transition) -> Transition:
    """The transition as the model sees it: as far as it went, from within the bounds."""
    if not state.limit:
        return transition
    start = bounded(transition.state, state.limit["limit"])
    return replace(transition, state=start, next_state=start + model.displacement(transition))


@dataclass(frozen=True)
class Regression:
    """W phi is fitted to the model's target."""

    fit: Fit
    model: Model
    needs_autograd: bool = False

    def describe(self, memory: Parameters) -> Parameters:
        """As the rule says, if it says anything (``describe``)."""
        offered = getattr(self.fit, "describe", None)
        return {} if offered is None else offered(memory)

    def initial(self, model: Parameters) -> Parameters:
        """See ``Estimator``."""
        return self.fit.initial(model["weight"])

    def begin(self, memory: Parameters, fresh: Tensor) -> Parameters:
        """As it is."""
        return memory

    def learn(self, state: LearnerState, transition: Transition, unit: Tensor) -> Lesson:
        """See ``Estimator``."""
        seen = _seen(self.model, state, transition)
        target = self.model.target(seen)
        phi = self.model.phi(seen.state, seen.action)
        fitted = self.fit.update(state.model["weight"], state.fit, phi, target, unit)
        parameters = state.model | {"weight": fitted.weight}
        return Lesson(
            parameters, fitted.memory, fitted.residual, phi, seen.next_state, state.observer
        )


@dataclass(frozen=True)
class ByGradient:
    """All parameters are fitted."""

    fit: ParameterFit
    model: Model
    needs_autograd: bool = True

    def describe(self, memory: Parameters) -> Parameters:
        """Nothing."""
        return {}

    def initial(self, model: Parameters) -> Parameters:
        """See ``Estimator``."""
        return self.fit.initial_memory(self.model, model)

    def begin(self, memory: Parameters, fresh: Tensor) -> Parameters:
        """As it is."""
        return memory

    def learn(self, state: LearnerState, transition: Transition, unit: Tensor) -> Lesson:
        """See ``Estimator``."""
        seen = _seen(self.model, state, transition)
        fitted = self.fit.improve(self.model, state.model, state.fit, seen)
        phi = self.model.phi(seen.state, seen.action)
        return Lesson(
            fitted.parameters,
            fitted.memory,
            fitted.residual,
            phi,
            seen.next_state,
            state.observer,
        )


@dataclass(frozen=True)
class Filtering:
    """Weights and state are estimated together, from readings that err."""

    fit: JointFilter
    observer: Observer
    needs_autograd: bool = False

    def describe(self, memory: Parameters) -> Parameters:
        """Nothing."""
        return {}

    def initial(self, model: Parameters) -> Parameters:
        """See ``Estimator``."""
        return self.fit.initial(model["weight"])

    def begin(self, memory: Parameters, fresh: Tensor) -> Parameters:
        """The state of a new episode is a new one."""
        begun = self.fit.begun(memory)
        return {name: select(fresh, begun[name], memory[name]) for name in memory}

    def learn(self, state: LearnerState, transition: Transition, unit: Tensor) -> Lesson:
        """See ``Estimator``; the transition ends at the belief's mean."""
        found = self.fit.update(
            state.model["weight"],
            state.fit,
            self.observer.belief(state.observer),
            state.limit.get("limit"),
            transition.action,
            transition.next_state,
            transition.dt,
        )
        return Lesson(
            state.model | {"weight": found.weight},
            found.memory,
            found.residual,
            found.phi,
            found.belief.mean,
            believed(state.observer, found.belief),
        )
