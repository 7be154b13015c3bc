"""The mean alone, as for the paper's bicycle."""

from __future__ import annotations

from dataclasses import dataclass

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.shapes import Rows
from edtorch.types import Belief


@dataclass(frozen=True)
class MeanOnly:
    """mean' = mu_pi(mean), nothing else.

    What the paper's bicycle uses: "the variance term in the transformed reward can simply be
    considered another form of error, and only mu~ need be estimated" (section 4).
    """

    propagates_covariance = False
    differentiates_reward = False
    exact_for_linear = True
    at_mean = True

    def keeps_positive(self, noise: StateFunction) -> bool:
        """The covariance is left as it is."""
        return True

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """Step 6a of Fig. 1."""
        return Belief(closed_loop(belief.mean), belief.cov)

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """r_pi at the mean."""
        return reward(belief.mean, policy(belief.mean))
