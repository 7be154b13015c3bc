"""The closed loop of an inverse policy, as the transforms take it: one step as it is written."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.inverse.policy import InversePolicy


def base_regressor(policy: InversePolicy, state: Tensor, acceleration: Tensor) -> Tensor:
    """psi(s, a) ``[*batch, 1 + 4 n + 2 p]``, physical units."""
    n = policy.layout.joints
    q = state[..., :n]
    one = torch.ones_like(state[..., :1])
    return torch.cat((one, state[..., n:], q.sin(), q.cos(), acceleration), -1)


def base_acceleration(base: Tensor, psi: Tensor) -> Tensor:
    """V psi ``[*batch, p]``."""
    return (base @ psi.unsqueeze(-1)).squeeze(-1)


@dataclass(frozen=True)
class InverseLoop:
    """mu_pi(s, g), where the joints accelerate as the policy wants and the base answers.

    The goal stands with the state: x = (s, g) ``[*more, B, M, 2 (n + p) + n]``, and stays where it
    is.  theta ``[B, n, outputs]``, base V ``[B, p, regressors]``, dt in s; see
    ``edtorch.inverse.unroll``.
    """

    policy: InversePolicy
    theta: Tensor
    base: Tensor
    dt: float

    def act(self, x: Tensor) -> Tensor:
        """The wish a, ``[*more, B, M, n]``."""
        size = self.policy.layout.size
        return self.policy.acceleration(self.theta.unsqueeze(-3), x[..., :size], x[..., size:])

    def __call__(self, x: Tensor) -> Tensor:
        """x a step of ``dt`` later."""
        size, d = self.policy.layout.size, self.dt
        a = self.act(x)
        psi = base_regressor(self.policy, x[..., :size], a)
        push = torch.cat((a, base_acceleration(self.base.unsqueeze(-3), psi)), -1)
        position, rate = x[..., : size // 2], x[..., size // 2 : size]
        moved = position + d * rate + 0.5 * d * d * push
        return torch.cat((moved, rate + d * push, x[..., size:]), -1)
