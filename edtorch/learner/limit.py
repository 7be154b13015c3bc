r"""How large a command may be: bounds on what model and policy see of an observation.

Where one component of the state is to be brought to zero by way of the others (a heading, through a
lean), its size is a command: a policy linear in it asks for any multiple of what it asks for at 1.
``Ramp`` bounds it by the learner's age; ``Safe`` by the largest command for which the model
predicts that the constrained components stay within their limits, mean plus k standard deviations:

    c = min_{tau, i} (share L_i - k sigma_{tau, i}) / |m_{tau, i}|,

m_tau being the mean of the closed loop's response to a command held at 1 from rest, and
Sigma_tau the covariance that its noise adds up to meanwhile.  In a linear loop the response grows
with the command, the covariance does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from edtorch.learner.annealing import Annealed
from edtorch.model.models import Model
from edtorch.model.noise import Noise
from edtorch.policy.policies import Policy
from edtorch.shapes import States
from edtorch.types import Parameters
from edtorch.value.linear.loop import linear_loop

_NO_RESPONSE = 1e-30
"""As good as none, and above zero in float32."""


class CommandLimit(Protocol):
    """A rule for how far from zero each component of an observation is taken for what it is."""

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, ticks: Tensor
    ) -> Tensor:
        """Bounds ``[B, n]`` in scaled units, inf where there is none; ticks ``[B]``: the ages."""
        ...


def _at(index: int, states: int, bound: Tensor) -> Tensor:
    """``bound`` ``[B]`` for one component, inf for the others, ``[B, n]``."""
    chosen = torch.arange(states, device=bound.device) == index
    return torch.where(chosen, bound.unsqueeze(-1), torch.inf)


@dataclass(frozen=True)
class Ramp:
    """The component ``index`` of ``states`` is bounded by ``bound``, a function of the age."""

    index: int
    states: int
    bound: Annealed
    dtype: torch.dtype

    def __post_init__(self) -> None:
        for name in ("start", "final"):
            if not getattr(self.bound, name) > 0:
                raise ValueError(f"{name}={getattr(self.bound, name)}: expected a number > 0")

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, ticks: Tensor
    ) -> States:
        """See ``CommandLimit``."""
        return _at(self.index, self.states, self.bound(ticks, self.dtype))


@dataclass(frozen=True)
class Safe:
    """Within ``ramp``, and no more than what the model says is safe.

    model, policy: templates, linear; noise: the rule for nu~, needed where deviations k > 0; dt:
    seconds a step of the prediction; horizon: steps; limits: by index, in scaled units; share: of
    a limit that a command may use up, a function of the age, since a young model's predictions are
    not to be relied on; actions: bounds of the actions, by index, in scaled units, which the
    response is not to exceed: beyond them the loop is not the linear one that was predicted.  The
    response is that of the other components to this one.
    """

    ramp: Ramp
    model: Model
    policy: Policy
    noise: Noise | None
    dt: float
    horizon: int
    limits: Sequence[tuple[int, float]]
    share: Annealed
    deviations: float = 0.0
    actions: Sequence[tuple[int, float]] = ()
    rest: Tensor = field(init=False)

    def __post_init__(self) -> None:
        if not self.limits:
            raise ValueError("limits: expected at least one component of the state with a limit")
        for index, limit in self.limits:
            if not limit > 0:
                raise ValueError(f"limits[{index}]={limit}: expected a number > 0")
            if index == self.ramp.index:
                raise ValueError(f"limits[{index}]: the command itself has a limit; name another")
        for name, share in (("share_start", self.share.start), ("share", self.share.final)):
            if not 0 < share <= 1:
                raise ValueError(f"{name}={share}: expected a number in (0, 1]")
        for index, bound in self.actions:
            if not bound > 0:
                raise ValueError(f"actions[{index}]={bound}: expected a number > 0")
        if not self.deviations >= 0:
            raise ValueError(f"deviations={self.deviations}: expected a number >= 0")
        if self.deviations > 0 and (self.noise is None or not self.noise.is_constant):
            raise ValueError(f"deviations={self.deviations}: expected a constant rule for nu~")
        if self.horizon < 1:
            raise ValueError(f"horizon={self.horizon}: expected at least one step")
        first = (self.model.initial([0]), self.policy.initial([0]))
        loop = linear_loop(self.model, self.policy, *first, self.dt)
        if loop.augmented:
            raise ValueError("features: expected a linear model and policy, without a constant")
        rest = torch.arange(self.ramp.states, device=self.model.period.device) != self.ramp.index
        object.__setattr__(self, "rest", rest.to(self.model.period.dtype))

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, ticks: Tensor
    ) -> States:
        """See ``CommandLimit``."""
        loop = linear_loop(self.model, self.policy, model, policy, self.dt)
        D = loop.drift + loop.G @ loop.theta
        # The command stays what it is, whatever the others do.
        D = D * self.rest.unsqueeze(-1)
        mean = (1 - self.rest).expand(D.shape[:-1])
        nu = cov = torch.zeros_like(D)
        watched = self.noise is not None and self.deviations > 0
        if self.noise is not None and watched:
            nu = self.model.noise_over(self.noise.covariance(noise, mean), self.dt)
            nu = nu * self.rest.unsqueeze(-1) * self.rest
        allowed = self.ramp.bound(ticks, self.ramp.dtype)
        share = self.share(ticks, self.ramp.dtype)
        for _ in range(self.horizon):
            for index, bound in self.actions:
                action = (loop.theta[..., index, :] * mean).sum(-1)
                allowed = torch.minimum(allowed, bound / action.abs().clamp(min=_NO_RESPONSE))
            mean = mean + (D @ mean.unsqueeze(-1)).squeeze(-1)
            if watched:
                half = cov + D @ cov
                cov = half + half @ D.mT + nu
            for index, limit in self.limits:
                room = share * limit
                if watched:
                    room = (room - self.deviations * cov[..., index, index].sqrt()).clamp(min=0.0)
                response = mean[..., index].abs().clamp(min=_NO_RESPONSE)
                allowed = torch.minimum(allowed, room / response)
        # A prediction that overflows allows no command.
        allowed = torch.where(allowed >= 0, allowed, 0.0)
        return _at(self.ramp.index, self.ramp.states, allowed)
