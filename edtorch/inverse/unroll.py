"""The value of an inverse policy and its gradient, by an adjoint written out (Fig. 1, 3 to 7).

The inverse model sees to it that the joints accelerate as the policy wants; what is unrolled is
therefore the policy alone, with a linear model of how the base answers:

    q' = q + d dq + d^2/2 a,   dq' = dq + d a,   a = A tanh(k Theta z / A)
    o' = o + d do + d^2/2 b,   do' = do + d b,   b = V psi(s, a)

    psi = (1, o, dq, do, sin q, cos q, a)

    value = -sum_tau w_tau |q_tau - g|^2,  tau = 1..T.

This is a loop of ``edtorch.inverse.adjoint``; with the covariance, it adds -sum_tau w_tau tr of
Sigma_qq, with nu from accelerations that turn out otherwise than foreseen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor

from edtorch.inverse.adjoint import Adjoint, Loop, adjoint
from edtorch.inverse.covariance import adjoint_with_covariance
from edtorch.inverse.policy import InversePolicy
from edtorch.value.unroll import Horizon, ValueGradient


def driven(policy: InversePolicy, theta: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
    """K ``[B, n, S]`` and c ``[B, M, n]`` of k Theta z / A = K s + c; goal ``[B, M, n]``."""
    drive = theta * (policy.gain / policy.unit)
    of_goal = drive @ policy.of_goal.to(theta)
    constant = (drive @ policy.constant.to(theta)).unsqueeze(-2)
    return drive @ policy.of_state.to(theta), goal @ of_goal.mT + constant


def by_theta(policy: InversePolicy, found: Adjoint, goal: Tensor) -> Tensor:
    """dV/dTheta ``[B, n, outputs]``, summed over the M states, of which the goals are ``goal``."""
    total = found.by_gains @ policy.of_state.to(goal).mT
    total = total + found.by_offset.mT @ goal @ policy.of_goal.to(goal).mT
    total = total + found.by_offset.sum(-2).unsqueeze(-1) * policy.constant.to(goal)
    return total * (policy.gain / policy.unit)


class InverseValue(Protocol):
    """A way to the value of inverse policies and its gradient, from M states of each learner."""

    @property
    def policy(self) -> InversePolicy:
        """The policy."""
        ...

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        ...

    @property
    def propagates_covariance(self) -> bool:
        """Whether nu enters."""
        ...

    def __call__(
        self,
        theta: Tensor,
        base: Tensor,
        state: Tensor,
        goal: Tensor,
        noise: Tensor | None = None,
        /,
    ) -> ValueGradient:
        """Value ``[B]`` and dV/dTheta (``weight``), means over the M states.

        theta ``[B, n, outputs]``, base V ``[B, p, regressors]``, state ``[B, M, 2 (n + p)]``,
        goal ``[B, M, n]``, physical units; noise nu~ of all accelerations, per second,
        ``[B, n + p, n + p]``, None for none.
        """
        ...


def check_horizon(horizon: Horizon) -> None:
    """Refuse a value that counts the present state."""
    if horizon.reading != "figure":
        raise ValueError(
            f"reading={horizon.reading}: expected figure with an inverse policy, whose"
            " present distance from the goal no action changes"
        )


def check_weight(weight: float) -> None:
    """Refuse a reward that is none."""
    if not weight > 0:
        raise ValueError(f"goal={weight}: expected a number > 0")


def regressors(policy: InversePolicy) -> int:
    """Size of psi."""
    return 1 + 4 * policy.layout.joints + 2 * policy.layout.others


def start_covariance(policy: InversePolicy, deviation: float) -> Tensor:
    """Sigma ``[S, S]`` that an unroll begins with; deviation: of each component, scaled."""
    return (deviation * policy.layout.scale).square().diag()


def step_noise(policy: InversePolicy, noise: Tensor, dt: float) -> Tensor:
    """nu ``[B, S, S]`` of one step from nu~ ``[B, n + p, n + p]`` per second.

    The mean of white accelerations over the step has the covariance nu~ / dt.
    """
    pushed = _pushed(policy, dt).to(noise)
    return pushed @ (noise / dt) @ pushed.mT


def _pushed(policy: InversePolicy, dt: float) -> Tensor:
    """The effect of all accelerations in one step, ``[S, n + p]``."""
    eye = torch.eye(policy.layout.size // 2, dtype=torch.float64)
    return torch.cat((0.5 * dt * dt * eye, dt * eye))


@dataclass(frozen=True)
class InverseUnroll:
    """Value and gradient of an inverse policy, from several states of each learner at once.

    weight: of the squared distance from the goal, in the reward; propagates_covariance: to first
    order, from a covariance of start_deviation^2 (scaled) on.
    """

    policy: InversePolicy
    horizon: Horizon
    weight: float = 1.0
    propagates_covariance: bool = False
    start_deviation: float = 0.0
    needs_autograd: bool = False

    def __post_init__(self) -> None:
        check_horizon(self.horizon)
        check_weight(self.weight)

    @cached_property
    def _integration(self) -> tuple[Tensor, Tensor]:
        """F ``[S, S]`` and the effect of all accelerations ``[S, n + p]``."""
        layout = self.policy.layout
        half = layout.size // 2
        free = torch.eye(layout.size, dtype=torch.float64)
        free[:half, half:].diagonal().fill_(self.horizon.dt)
        return free, _pushed(self.policy, self.horizon.dt)

    @cached_property
    def _start(self) -> Tensor:
        return start_covariance(self.policy, self.start_deviation)

    @cached_property
    def _angles(self) -> Tensor:
        return torch.arange(self.policy.layout.joints)

    def _step(self, base: Tensor) -> tuple[Tensor, Tensor]:
        """L ``[B, S, S + 3 n]`` and l ``[B, 1, S]`` from V ``[B, p, regressors]``."""
        layout = self.policy.layout
        n, size = layout.joints, layout.size
        free, pushed = (matrix.to(base) for matrix in self._integration)
        # psi without its 1, with columns for q, which V does not know.
        unknown = base.new_zeros(*base.shape[:-1], n)
        answer = pushed[:, n:] @ torch.cat((unknown, base[..., 1:]), -1)
        step = answer.clone()
        step[..., :size] += free
        step[..., -n:] += pushed[:, :n]
        step[..., -n:] *= self.policy.unit
        return step, (pushed[:, n:] @ base[..., :1]).mT

    def __call__(
        self,
        theta: Tensor,
        base: Tensor,
        state: Tensor,
        goal: Tensor,
        noise: Tensor | None = None,
    ) -> ValueGradient:
        """See ``InverseValue``."""
        policy = self.policy
        step, shift = self._step(base)
        loop = Loop(
            step, shift, *driven(policy, theta, goal), self._angles, policy.limit is not None
        )
        weights = [w * self.weight for w in self.horizon.weights()]
        if self.propagates_covariance:
            half = policy.layout.size // 2
            noise = base.new_zeros(len(base), half, half) if noise is None else noise
            nu = step_noise(policy, noise, self.horizon.dt)
            found = adjoint_with_covariance(loop, state, goal, weights, nu, self._start)
        else:
            found = adjoint(loop, state, goal, weights)
        gradient = by_theta(policy, found, goal) / state.shape[-2]
        return ValueGradient(found.value.mean(-1), {"weight": gradient})
