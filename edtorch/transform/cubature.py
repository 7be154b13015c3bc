"""The third-degree spherical-radial cubature: 2n points, no derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.shapes import Rows
from edtorch.transform import points
from edtorch.transform.noise import is_positive
from edtorch.types import Belief


def cubature_nodes(like: Tensor) -> points.Nodes:
    """+-sqrt(n) e_i, each with the weight 1/2n, for states ``like`` ``[*batch, n]``."""
    n = like.shape[-1]
    axes = math.sqrt(n) * torch.eye(n, dtype=like.dtype, device=like.device)
    return points.Nodes(torch.cat([axes, -axes]), like.new_full((2 * n,), 1 / (2 * n)))


@dataclass(frozen=True)
class Cubature:
    """Moments of mu_pi, nu_pi and r_pi over 2n points s~ +- sqrt(n) L e_i of equal weight.

    Exact for polynomials up to degree 3 under a Gaussian belief, so the one-step errors are of the
    order of Sigma^2 where the first-order transform's are of the order of Sigma.  The weights are
    positive, hence the covariance is positive semidefinite by construction, in every dimension.
    Square root and jitter: ``edtorch.transform.points``.

    Source: I. Arasaratnam and S. Haykin, "Cubature Kalman Filters", IEEE Transactions on Automatic
    Control 54 (2009) 1254-1269.
    """

    propagates_covariance = True
    differentiates_reward = False
    exact_for_linear = True

    def keeps_positive(self, noise: StateFunction) -> bool:
        """True if nu is positive: a mean of covariances is a covariance."""
        return is_positive(noise)

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """One step; see the class."""
        return points.move(belief, closed_loop, noise, cubature_nodes(belief.mean))

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """r_pi averaged over the same kind of points; exact for r_pi of degree 3."""
        return points.reward(reward, belief, policy, cubature_nodes(belief.mean))
