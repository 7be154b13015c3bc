"""The value of an inverse policy under any transform, differentiated by torch: the oracle of
``edtorch.inverse.unroll``, and the way for transforms that have nothing written out."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import grad_and_value
from torch.nn.functional import pad

from edtorch.inverse.loop import InverseLoop
from edtorch.inverse.policy import InversePolicy
from edtorch.inverse.unroll import check_horizon, check_weight, start_covariance, step_noise
from edtorch.rewards import QuadraticReward
from edtorch.transform import ConstantNoise, Transform
from edtorch.types import Belief
from edtorch.value.unroll import Horizon, ValueGradient, propagate


@dataclass(frozen=True)
class GenericInverse:
    """As ``edtorch.inverse.unroll.InverseUnroll``, by ``edtorch.value.unroll.propagate``.

    The state that is unrolled is (s, g), of which g is known and stays.
    """

    policy: InversePolicy
    horizon: Horizon
    transform: Transform
    weight: float = 1.0
    start_deviation: float = 0.0
    needs_autograd: bool = True

    def __post_init__(self) -> None:
        check_horizon(self.horizon)
        check_weight(self.weight)

    @property
    def propagates_covariance(self) -> bool:
        """Whether nu enters."""
        return self.transform.propagates_covariance

    def _reward(self) -> QuadraticReward:
        layout = self.policy.layout
        n, size = layout.joints, layout.size
        eye = torch.eye(n, dtype=torch.float64)
        lacking = torch.cat((eye, torch.zeros(n, size - n, dtype=torch.float64), -eye), -1)
        nothing = torch.zeros(n, n, dtype=torch.float64)
        return QuadraticReward(self.weight * lacking.mT @ lacking, nothing)

    def __call__(
        self,
        theta: Tensor,
        base: Tensor,
        state: Tensor,
        goal: Tensor,
        noise: Tensor | None = None,
    ) -> ValueGradient:
        """See ``edtorch.inverse.unroll.InverseValue``."""
        layout = self.policy.layout
        x = torch.cat((state, goal), -1)
        known = layout.joints
        cov = pad(start_covariance(self.policy, self.start_deviation), (0, known, 0, known))
        added = torch.zeros_like(cov)
        if noise is not None:
            nu = step_noise(self.policy, noise, self.horizon.dt)
            added = pad(nu, (0, known, 0, known)).unsqueeze(1)
        start = Belief(x, cov.expand(*x.shape, x.shape[-1]))
        reward = self._reward()

        def total(parameters: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
            loop = InverseLoop(self.policy, parameters, base, self.horizon.dt)
            found = propagate(
                start,
                loop,
                loop.act,
                reward=reward,
                transform=self.transform,
                noise=ConstantNoise(added),
                horizon=self.horizon,
            )
            value = found.value.mean(-1)
            return value.sum(), (value, found.first_floored)

        gradient, (_, (value, floored)) = grad_and_value(total, has_aux=True)(theta)
        assert isinstance(gradient, Tensor)
        first = torch.where(floored < 0, self.horizon.steps + 1, floored).amin(-1)
        first = torch.where(first > self.horizon.steps, -1, first)
        return ValueGradient(value, {"weight": gradient}, first)
