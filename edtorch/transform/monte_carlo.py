"""Gaussian moment matching by random draws: a reference for tests in any dimension."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.shapes import Rows
from edtorch.transform import points
from edtorch.transform.noise import is_positive
from edtorch.types import Belief


class MonteCarlo:
    """Moments over ``samples`` standard normal draws for n = ``states``, the same at every step.

    The draws, from ``generator``, are standardised (mean 0, covariance I exactly), so that linear
    closed loops and quadratic rewards are exact and only the rest is random.  ValueError unless
    there are more samples than states.
    """

    propagates_covariance = True
    differentiates_reward = False

    def __init__(self, samples: int, states: int, generator: torch.Generator) -> None:
        if samples <= states:
            raise ValueError(f"samples={samples}: expected more than the {states} states")
        draws = torch.randn(samples, states, generator=generator, dtype=torch.float64)
        centred = draws - draws.mean(0)
        lower = torch.linalg.cholesky(centred.mT @ centred / samples)
        self._draws = torch.linalg.solve_triangular(lower, centred.mT, upper=False).mT

    def _nodes(self, like: Tensor) -> points.Nodes:
        count = len(self._draws)
        return points.Nodes(self._draws.to(like), like.new_full((count,), 1 / count))

    def keeps_positive(self, noise: StateFunction) -> bool:
        """True if nu is positive: a mean of covariances is a covariance."""
        return is_positive(noise)

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """One step; see the class."""
        return points.move(belief, closed_loop, noise, self._nodes(belief.mean))

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """r_pi averaged over the draws."""
        return points.reward(reward, belief, policy, self._nodes(belief.mean))
