"""One step of the deterministic process M': belief -> next belief (eq. 2; section 3).

A transform is chosen by object; it says how a belief moves through the closed loop mu_pi, what
reward it earns on the average, and whether it needs the model's noise nu~ at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from edtorch.rewards import Reward, StateFunction, expected_reward, rowwise_jacobian
from edtorch.types import Belief


class Transform(Protocol):
    """How mean and covariance move, and what they earn."""

    @property
    def propagates_covariance(self) -> bool:
        """Whether nu~ enters."""
        ...

    def move(self, belief: Belief, closed_loop: StateFunction, noise: Tensor) -> Belief:
        """The belief one step later; closed_loop mu_pi ``[*batch, n] -> [*batch, n]``, noise nu~
        ``[*batch, n, n]`` over that step."""
        ...

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
        """Expected reward ``[*batch]`` of a belief under the policy."""
        ...


@dataclass(frozen=True)
class MeanOnly:
    """mean' = mu_pi(mean), nothing else.

    What the paper's bicycle uses: "the variance term in the transformed reward can simply be
    considered another form of error, and only mu~ need be estimated" (section 4).
    """

    propagates_covariance: bool = False

    def move(self, belief: Belief, closed_loop: StateFunction, noise: Tensor) -> Belief:
        """Step 6a of Fig. 1."""
        return Belief(closed_loop(belief.mean), belief.cov)

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
        """r_pi at the mean."""
        return reward(belief.mean, policy(belief.mean))


@dataclass(frozen=True)
class FirstOrder:
    """mean' = mu_pi(mean), cov' = nu + J cov J' with J = d mu_pi / ds through the policy (eq. 2).

    J comes from ``torch.func.jacrev``.
    """

    propagates_covariance: bool = True

    def move(self, belief: Belief, closed_loop: StateFunction, noise: Tensor) -> Belief:
        """Steps 6a and 6b of Fig. 1."""
        jacobian = rowwise_jacobian(closed_loop, belief.mean)
        cov = noise + jacobian @ belief.cov @ jacobian.transpose(-1, -2)
        return Belief(closed_loop(belief.mean), 0.5 * (cov + cov.transpose(-1, -2)))

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
        """Step 6c of Fig. 1."""
        return expected_reward(reward, belief, policy)


def point_belief(state: Tensor) -> Belief:
    """All probability at ``state`` ``[*batch, n]`` (Fig. 1, steps 3 and 4)."""
    n = state.shape[-1]
    return Belief(state, torch.zeros(*state.shape, n, dtype=state.dtype, device=state.device))
