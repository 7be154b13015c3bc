"""The value of an inverse policy and its gradient, by an adjoint written out (Fig. 1, 3 to 7).

The inverse model sees to it that the joints accelerate as the policy wants; what is unrolled is
therefore the policy alone, with a linear model of how the base answers:

    q' = q + d dq + d^2/2 a,   dq' = dq + d a,   a = A tanh(k Theta z / A)
    o' = o + d do + d^2/2 b,   do' = do + d b,   b = V psi(s, a)

    psi = (1, o, dq, do, sin q, cos q, a)

    value = -sum_tau w_tau |q_tau - g|^2,  tau = 1..T.

This is a loop of ``edtorch.inverse.adjoint``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from edtorch.inverse.adjoint import Adjoint, Loop, adjoint
from edtorch.inverse.policy import InversePolicy
from edtorch.unroll import Horizon


def base_regressor(policy: InversePolicy, state: Tensor, acceleration: Tensor) -> Tensor:
    """psi(s, a) ``[*batch, 1 + 4 n + 2 p]``, physical units."""
    n = policy.layout.joints
    q = state[..., :n]
    one = torch.ones_like(state[..., :1])
    return torch.cat((one, state[..., n:], q.sin(), q.cos(), acceleration), -1)


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


@dataclass(frozen=True)
class InverseUnroll:
    """Value and gradient of an inverse policy, from several states of each learner at once.

    weight: of the squared distance from the goal, in the reward.
    """

    policy: InversePolicy
    horizon: Horizon
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.horizon.reading != "figure":
            raise ValueError(
                f"reading={self.horizon.reading}: expected figure with an inverse policy, whose"
                " present distance from the goal no action changes"
            )
        if not self.weight > 0:
            raise ValueError(f"goal={self.weight}: expected a number > 0")

    @property
    def regressors(self) -> int:
        """Size of psi."""
        layout = self.policy.layout
        return 1 + 4 * layout.joints + 2 * layout.others

    @cached_property
    def _integration(self) -> tuple[Tensor, Tensor]:
        """F ``[S, S]`` and the effect of all accelerations ``[S, n + p]``."""
        layout, d = self.policy.layout, self.horizon.dt
        half = layout.size // 2
        eye = torch.eye(half, dtype=torch.float64)
        free = torch.eye(layout.size, dtype=torch.float64)
        free[:half, half:] = d * eye
        return free, torch.cat((0.5 * d * d * eye, d * eye))

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
        self, theta: Tensor, base: Tensor, state: Tensor, goal: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Value ``[B]`` and dV/dTheta ``[B, n, outputs]``, means over the M states.

        theta ``[B, n, outputs]``, base V ``[B, p, regressors]``, state ``[B, M, 2 (n + p)]``,
        goal ``[B, M, n]``, physical units.
        """
        policy = self.policy
        step, shift = self._step(base)
        loop = Loop(
            step, shift, *driven(policy, theta, goal), self._angles, policy.limit is not None
        )
        weights = [w * self.weight for w in self.horizon.weights()]
        found = adjoint(loop, state, goal, weights)
        return found.value.mean(-1), by_theta(policy, found, goal) / state.shape[-2]

    def plain(self, theta: Tensor, base: Tensor, state: Tensor, goal: Tensor) -> Tensor:
        """The value ``[B]`` step by step, as it is written above: the oracle of ``__call__``."""
        policy, d = self.policy, self.horizon.dt
        half, n = policy.layout.size // 2, policy.layout.joints
        value = state.new_zeros(state.shape[:-1])
        for w in self.horizon.weights():
            a = policy.acceleration(theta.unsqueeze(-3), state, goal)
            b = base_regressor(policy, state, a) @ base.mT
            push = torch.cat((a, b), -1)
            position, rate = state[..., :half], state[..., half:]
            state = torch.cat((position + d * rate + 0.5 * d * d * push, rate + d * push), -1)
            value = value - w * self.weight * (state[..., :n] - goal).square().sum(-1)
        return value.mean(-1)
