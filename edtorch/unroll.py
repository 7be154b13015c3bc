"""The limited-horizon value of a policy under a model, and its gradient (Fig. 1, steps 3-6).

``unroll`` pushes a belief through any closed loop.  ``Generic`` differentiates it for any model,
policy, reward and transform; ``edtorch.closed_form`` gives the same for linear closed loops, much
faster; ``edtorch.dispatch`` decides between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torch.func import functional_call, grad_and_value

from edtorch.models import Model
from edtorch.policies import LinearPolicy
from edtorch.rewards import Reward, StateFunction
from edtorch.transform import Transform, point_belief
from edtorch.types import Belief, Parameters, Trajectory


@dataclass(frozen=True)
class Horizon:
    """T steps of ``dt`` seconds (``step`` in the discrete form), each reward weighted.

    The value is the sum over tau = 1..T of discount^((tau - 1) unit) unit r~_tau: Fig. 1's step 6d
    with unit = 1 in the discrete form, the Euler sum of section 4's integral with unit = dt and the
    discount per second in the derivative form.
    """

    steps: int
    dt: float
    discount: float
    unit: float

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"horizon={self.steps}: expected at least one step")
        if not self.dt > 0:
            raise ValueError(f"dt={self.dt}: expected a number > 0 (seconds)")
        if not 0 < self.discount <= 1:
            raise ValueError(f"discount={self.discount}: expected a number in (0, 1]")

    def weights(self) -> list[float]:
        """Weight of the expected reward of steps 1..T."""
        return [self.discount ** (tau * self.unit) * self.unit for tau in range(self.steps)]


def unroll(
    start: Belief,
    closed_loop: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    transform: Transform,
    noise: Tensor,
    horizon: Horizon,
) -> Trajectory:
    """Push ``start`` through T steps of the closed loop and add up its rewards (Fig. 1, step 6).

    closed_loop mu_pi and policy pi work row by row on ``[*batch, n]``; noise ``[*batch, n, n]`` is
    nu~ over one step.  Differentiable with respect to everything that they close over.
    """
    belief = start
    means, covs, rewards = [start.mean], [start.cov], []
    value = torch.zeros_like(start.mean[..., 0])
    for weight in horizon.weights():
        belief = transform.move(belief, closed_loop, noise)
        gain = transform.reward(reward, belief, policy)
        value = value + weight * gain
        means.append(belief.mean)
        covs.append(belief.cov)
        rewards.append(gain)
    return Trajectory(torch.stack(means), torch.stack(covs), torch.stack(rewards), value)


@dataclass(frozen=True)
class ValueGradient:
    """value ``[B]`` and its gradient with respect to each policy parameter ``[B, ...]``."""

    value: Tensor
    gradient: Parameters


class ValuePath(Protocol):
    """A way to the value and its gradient: (model, policy, noise, state ``[B, n]``).

    needs_autograd: whether it differentiates with torch; a loop over one that does not may run in
    torch's inference mode, which is a fifth faster.
    """

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        ...

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Tensor, state: Tensor
    ) -> ValueGradient:
        """Value of unrolling from ``state`` and dV/dtheta, learner by learner."""
        ...


@dataclass(frozen=True)
class Generic:
    """Any model and policy: reverse-mode differentiation of ``unroll``.

    The oracle for every faster path.  Learners do not mix, so the gradient of the sum of their
    values is each one's own gradient.
    """

    model: Model
    policy: LinearPolicy
    reward: Reward
    transform: Transform
    horizon: Horizon
    needs_autograd: bool = True

    def trajectory(
        self, model: Parameters, policy: Parameters, noise: Tensor, start: Belief
    ) -> Trajectory:
        """The unrolled horizon from ``start``."""

        def act(s: Tensor) -> Tensor:
            return functional_call(self.policy, policy, (s,))

        def closed_loop(s: Tensor) -> Tensor:
            return functional_call(self.model, model, (s, act(s), self.horizon.dt))

        return unroll(
            start,
            closed_loop,
            act,
            reward=self.reward,
            transform=self.transform,
            noise=self.model.noise_over(noise, self.horizon.dt),
            horizon=self.horizon,
        )

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Tensor, state: Tensor
    ) -> ValueGradient:
        """See ``ValuePath``."""

        def total(parameters: Parameters) -> tuple[Tensor, Tensor]:
            value = self.trajectory(model, parameters, noise, point_belief(state)).value
            return value.sum(), value

        gradient, (_, value) = grad_and_value(total, has_aux=True)(policy)
        return ValueGradient(value, gradient)
