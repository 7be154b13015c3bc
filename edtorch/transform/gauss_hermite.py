"""Gauss-Hermite quadrature on a tensor grid: a reference for tests, order^n points."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.shapes import Rows
from edtorch.transform import points
from edtorch.transform.noise import is_positive
from edtorch.types import Belief


def hermite_nodes(order: int, like: Tensor) -> points.Nodes:
    """The tensor grid of the ``order`` zeros of the Hermite polynomial, for states ``like``."""
    n = like.shape[-1]
    zeros, weights = np.polynomial.hermite_e.hermegauss(order)
    z = np.array(list(itertools.product(zeros, repeat=n)))
    w = np.array(list(itertools.product(weights / weights.sum(), repeat=n))).prod(-1)
    return points.Nodes(like.new_tensor(z), like.new_tensor(w))


@dataclass(frozen=True)
class GaussHermite:
    """Moments over ``order``^n points, exact up to degree 2 order - 1 in each variable.

    With a large order this is Gaussian moment matching itself.  order: 2 or more (one point has no
    spread), ValueError otherwise.
    """

    order: int = 3
    propagates_covariance = True
    differentiates_reward = False

    def __post_init__(self) -> None:
        if self.order < 2:
            raise ValueError(f"order={self.order}: expected 2 or more")

    def keeps_positive(self, noise: StateFunction) -> bool:
        """True if nu is positive: a mean of covariances is a covariance."""
        return is_positive(noise)

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """One step; see the class."""
        return points.move(belief, closed_loop, noise, hermite_nodes(self.order, belief.mean))

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """r_pi averaged over the grid."""
        return points.reward(reward, belief, policy, hermite_nodes(self.order, belief.mean))
