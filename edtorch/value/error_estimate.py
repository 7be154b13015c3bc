"""How far off the value of the first-order transform is, estimated by the second-order one."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.shapes import Rows
from edtorch.transform import FirstOrder, SecondOrder
from edtorch.types import Belief, LearnerState
from edtorch.value.unroll import Generic, Horizon, propagate


def value_error_estimate(
    start: Belief,
    closed_loop: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    noise: StateFunction,
    horizon: Horizon,
) -> Rows:
    """V'_second - V'_first ``[*batch]``: an estimate, with its sign, of V - V'_first.

    Same start, closed loop, policy and reward in both; arguments as in
    ``edtorch.value.unroll.unroll``. The paper's Theorems 1 to 4 bound |V - V'_first|; this is the
    leading term of it instead, with no claim to be a bound: it leaves out third derivatives and
    the distribution's own shape.  Pure and differentiable; in units of the value.
    """

    def value(transform: FirstOrder | SecondOrder) -> Tensor:
        return propagate(
            start,
            closed_loop,
            policy,
            reward=reward,
            transform=transform,
            noise=noise,
            horizon=horizon,
        ).value

    return value(SecondOrder()) - value(FirstOrder())


@dataclass(frozen=True)
class ValueErrorIndicator:
    """``value_error_estimate`` for a population of learners where they stand.

    generic: the generic path of the same model, policy, reward and noise.
    """

    generic: Generic

    def __call__(self, learners: LearnerState, state: Tensor) -> Tensor:
        """``[B]``, from states ``[B, n]``."""
        # A loop may have made inference tensors, which cannot be differentiated; copies can.
        model, policy, noise = (
            {name: p.clone() for name, p in part.items()}
            for part in (learners.model, learners.policy, learners.noise)
        )
        loop = self.generic.loop(model, policy)
        return value_error_estimate(
            self.generic.start(state.clone()),
            loop,
            loop.act,
            reward=self.generic.reward,
            noise=self.generic.noise_of(loop, noise, state),
            horizon=self.generic.horizon,
        )
