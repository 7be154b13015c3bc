"""What is made of readings that are late or err: an estimate of the state of now.

A learner without an observer takes each observation for the state.  With one it acts upon the
estimate, and learns from transitions whose action is the one that really led to the reading.  A
frozen policy needs the same observer, and the model it estimates with (``Learner.acting``).
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.learner.delay import Delay
from edtorch.learner.filter import JointFilter
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.policy.policies import bounded
from edtorch.types import Belief, Parameters, Transition, replace, select


@dataclass(frozen=True)
class Observer:
    """model: to estimate with; delay: of the readings; filter: of their errors, None takes them
    for exact; dt ``[]``: seconds a tick.

    Its memory: that of ``Delay``, and with a filter the belief about the state at the time of the
    last reading, ``mean`` ``[B, n]`` and ``cov`` ``[B, n, n]``.  What it estimates with are
    ``parameters``: the weights of the model under ``model``, perhaps a ``limit``.
    """

    model: DerivativeModel | NextStateModel
    delay: Delay
    filter: JointFilter | None
    dt: Tensor

    def __post_init__(self) -> None:
        if not getattr(self.model, "linear_in_parameters", False):
            raise ValueError(
                f"expected a model linear in features to estimate with, not"
                f" {type(self.model).__name__}"
            )

    def initial(self, observation: Tensor) -> Parameters:
        """Everybody at the beginning of an episode, from the first observation ``[B, n]``."""
        action = observation.new_zeros(len(observation), self.model.actions)
        memory = self.delay.initial(action)
        if self.filter is None:
            return memory
        return memory | _of(self.filter.first(observation))

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor) -> Parameters:
        """New episodes for those that are ``fresh`` ``[B]``."""
        new = self.initial(observation)
        return {name: select(fresh, new[name], memory[name]) for name in memory}

    def now(self, parameters: Parameters, memory: Parameters, observation: Tensor) -> Tensor:
        """The estimate of the state ``[B, n]`` at this moment, scaled like the observation."""
        weight, limit = parameters["model"], parameters.get("limit")

        def move(state: Tensor, action: Tensor) -> Tensor:
            start = state if limit is None else bounded(state, limit)
            phi = self.model.phi(start, action)
            return state + self.model.change(weight, phi, start, self.dt)

        here = observation if self.filter is None else memory["mean"]
        return self.delay.ahead(memory, here, move)

    def paired(self, memory: Parameters, transition: Transition) -> tuple[Transition, Parameters]:
        """The transition between two readings with the action that led to the later one, none to
        learn from as long as that action is not known; and the memory with this tick's action."""
        action, there, late = self.delay.push(memory, transition.action)
        paired = replace(transition, action=action, valid=transition.valid & there)
        return paired, memory | late

    def belief(self, memory: Parameters) -> Belief:
        """About the state at the time of the last reading, with a filter."""
        return Belief(memory["mean"], memory["cov"])

    def follow(
        self, parameters: Parameters, memory: Parameters, transition: Transition
    ) -> Parameters:
        """The memory after a tick of a frozen policy."""
        paired, memory = self.paired(memory, transition)
        if self.filter is None:
            return memory
        belief = self.filter.follow(
            parameters["model"],
            self.belief(memory),
            parameters.get("limit"),
            paired.action,
            paired.next_state,
            self.dt,
        )
        found = believed(memory, belief)
        return {name: select(paired.valid, found[name], memory[name]) for name in memory}


def believed(memory: Parameters, belief: Belief) -> Parameters:
    """The memory of an observer with a filter, with another belief."""
    return memory | _of(belief)


def _of(belief: Belief) -> Parameters:
    return {"mean": belief.mean, "cov": belief.cov}
