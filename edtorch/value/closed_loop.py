"""The closed loop mu_pi(s) = mu~(s, pi(s)) of given parameters, as the transforms take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from edtorch.model.models import Model, dynamics_of
from edtorch.model.noise import Noise
from edtorch.policy.policies import Policy, gain_of
from edtorch.types import Parameters


@dataclass(frozen=True)
class ClosedLoop:
    """A model and a policy, each with the parameters of a whole population, over ``dt`` seconds."""

    model: Model
    policy: Policy
    model_parameters: Parameters
    policy_parameters: Parameters
    dt: float

    def act(self, state: Tensor) -> Tensor:
        """pi(s), ``[*batch, n] -> [*batch, m]``."""
        return self.policy.action(self.policy_parameters, state)

    def __call__(self, state: Tensor) -> Tensor:
        """mu_pi(s), ``[*batch, n] -> [*batch, n]``."""
        return self.model.next(self.model_parameters, state, self.act(state), self.dt)

    def jacobian(self, state: Tensor) -> Tensor | None:
        """F + G theta ``[*batch, n, n]`` where model and policy are linear in the state or None."""
        dynamics = dynamics_of(self.model, self.model_parameters, self.dt)
        gain = gain_of(self.policy, self.policy_parameters)
        if dynamics is None or gain is None:
            return None
        closed = dynamics.state + dynamics.action @ gain.state
        return closed.expand(*state.shape, state.shape[-1])


@dataclass(frozen=True)
class LoopNoise:
    """nu_pi(s) = nu~(s, pi(s)) over one step of ``loop``, from a learned rule and its memory."""

    loop: ClosedLoop
    rule: Noise
    memory: Parameters
    positive: ClassVar[bool] = True

    def __call__(self, state: Tensor) -> Tensor:
        """``[*batch, n] -> [*batch, n, n]``."""
        model = self.loop.model
        phi = model.phi(state, self.loop.act(state))
        cov = model.noise_over(self.rule.covariance(self.memory, phi), self.loop.dt)
        return cov.expand(*state.shape, state.shape[-1])
