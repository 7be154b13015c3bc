"""The paper's transform: mean and covariance to first order (eq. 2; section 3)."""

from __future__ import annotations

from dataclasses import dataclass

from edtorch.derivatives import StateFunction, loop_jacobian
from edtorch.rewards import Reward, expected_reward
from edtorch.shapes import Rows
from edtorch.transform.noise import is_positive
from edtorch.transform.positive import symmetric
from edtorch.types import Belief


@dataclass(frozen=True)
class FirstOrder:
    """mean' = mu_pi(mean), cov' = nu_pi(mean) + J cov J' with J = d mu_pi / ds (eq. 2).

    J is the closed loop's own where it offers one, else ``torch.func.jacrev``'s, through model and
    policy.  Exact for linear mu_pi with nu_pi linear in the state, whatever the distribution; the
    one-step error of the mean is 1/2 H:cov to leading order.
    """

    propagates_covariance = True
    differentiates_reward = True
    exact_for_linear = True
    at_mean = True

    def keeps_positive(self, noise: StateFunction) -> bool:
        """True if nu is positive: J cov J' always is."""
        return is_positive(noise)

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """Steps 6a and 6b of Fig. 1."""
        jacobian = loop_jacobian(closed_loop, belief.mean)
        cov = noise(belief.mean) + jacobian @ belief.cov @ jacobian.mT
        return Belief(closed_loop(belief.mean), symmetric(cov))

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """Step 6c of Fig. 1."""
        return expected_reward(reward, belief, policy)
