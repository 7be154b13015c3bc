"""Gaussian moment matching by random draws: a reference for tests in any dimension."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.transform import points
from edtorch.transform.noise import is_positive
from edtorch.types import Belief


@dataclass(frozen=True)
class MonteCarlo:
    """Moments over given standard normal ``draws`` ``[N, n]``, N > n, the same at every step.

    The draws are standardised (mean 0, covariance I exactly), so that linear closed loops and
    quadratic rewards are exact and only the rest is random.  A ValueError names too few of them.
    """

    draws: Tensor
    propagates_covariance = True
    differentiates_reward = False

    def __post_init__(self) -> None:
        if self.draws.ndim != 2 or self.draws.shape[0] <= self.draws.shape[1]:
            raise ValueError(f"draws have shape {tuple(self.draws.shape)}, expected [N, n], N > n")
        centred = self.draws - self.draws.mean(0)
        lower = torch.linalg.cholesky(centred.mT @ centred / len(centred))
        whitened = torch.linalg.solve_triangular(lower, centred.mT, upper=False).mT
        object.__setattr__(self, "draws", whitened)

    @classmethod
    def drawn(cls, samples: int, states: int, generator: torch.Generator) -> MonteCarlo:
        """With ``samples`` float64 draws for ``states`` variables from ``generator``."""
        return cls(torch.randn(samples, states, generator=generator, dtype=torch.float64))

    def _nodes(self) -> points.Nodes:
        count = len(self.draws)
        return points.Nodes(self.draws, self.draws.new_full((count,), 1 / count))

    def keeps_positive(self, noise: StateFunction) -> bool:
        """A mean of covariances is one, so all depends on nu."""
        return is_positive(noise)

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """One step; see the class."""
        return points.move(belief, closed_loop, noise, self._nodes())

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
        """r_pi averaged over the draws."""
        return points.reward(reward, belief, policy, self._nodes())
