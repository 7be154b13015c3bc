"""The value of an inverse policy and its gradient, by an adjoint written out (Fig. 1, 3 to 7).

The inverse model sees to it that the joints accelerate as the policy wants; what is unrolled is
therefore the policy alone, with a linear model of how the base answers:

    q' = q + d dq + d^2/2 a,   dq' = dq + d a,   a = A tanh(k Theta z / A)
    o' = o + d do + d^2/2 b,   do' = do + d b,   b = V psi(s, a)

    psi = (1, o, dq, do, sin q, cos q, a)

    value = -sum_tau w_tau |q_tau - g|^2,  tau = 1..T.

One step is s' = L (s, sin q, cos q, t) + l with t = tanh(k Theta z / A), so that a step and its
adjoint are two products of matrices each: autograd takes five times as long.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from edtorch.inverse.policy import InversePolicy
from edtorch.unroll import Horizon


def base_regressor(policy: InversePolicy, state: Tensor, acceleration: Tensor) -> Tensor:
    """psi(s, a) ``[*batch, 1 + 4 n + 2 p]``, physical units."""
    n = policy.layout.joints
    q = state[..., :n]
    one = torch.ones_like(state[..., :1])
    return torch.cat((one, state[..., n:], q.sin(), q.cos(), acceleration), -1)


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
        policy, n = self.policy, self.policy.layout.joints
        size, starts = policy.layout.size, state.shape[-2]
        weights = [w * self.weight for w in self.horizon.weights()]
        step, shift = self._step(base)
        rate = policy.gain / policy.unit
        of_state, of_goal = policy.of_state.to(theta), policy.of_goal.to(theta)
        gains = rate * (theta @ of_state)
        constant = rate * (theta @ policy.constant.to(theta)).unsqueeze(-2)
        offset = rate * (goal @ (theta @ of_goal).mT) + constant

        step_t, gains_t = step.mT.contiguous(), gains.mT.contiguous()
        path: list[Tensor] = []
        s, distance = state, []
        value = state.new_zeros(state.shape[:-1])
        for w in weights:
            drive = torch.baddbmm(offset, s, gains_t)
            t = drive if policy.limit is None else drive.tanh()
            q = s[..., :n]
            x = torch.cat((s, q.sin(), q.cos(), t), -1)
            path.append(x)
            s = torch.baddbmm(shift, x, step_t)
            away = s[..., :n] - goal
            distance.append(away)
            value = value - w * away.square().sum(-1)

        costate = torch.zeros_like(state)
        drives: list[Tensor] = []
        for w, x, away in zip(reversed(weights), reversed(path), reversed(distance), strict=True):
            costate[..., :n] -= (2 * w) * away
            pulled = costate @ step
            by_state, by_sine, by_cosine, by_t = pulled.split((size, n, n, n), -1)
            sine, cosine, t = x[..., size:].split((n, n, n), -1)
            by_drive = by_t if policy.limit is None else by_t * (1 - t * t)
            drives.append(by_drive)
            costate = torch.baddbmm(by_state, by_drive, gains)
            costate[..., :n] += by_sine * cosine - by_cosine * sine

        # dV/dTheta = rate sum (dV/d drive) z', with z linear in state and goal.
        by_drive = torch.cat(drives[::-1], -2)
        states = torch.cat([x[..., :size] for x in path], -2)
        total = by_drive.mT @ states @ of_state.mT
        by_goal = torch.stack(drives).sum(0)
        total = total + by_goal.mT @ goal @ of_goal.mT
        total = total + by_goal.sum(-2).unsqueeze(-1) * policy.constant.to(theta)
        return value.mean(-1), total * (rate / starts)

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
