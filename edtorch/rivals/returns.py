"""The return of an episode: its discounted shaping reward, added up as it goes.

An episode that fails stops earning, and where rewards are costs that would be a gain.  So the rest
of the time, up to a horizon, is charged at a rate of its own (``charge``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.rewards import QuadraticReward, Reward
from edtorch.rivals.episodes import EpisodeTick


class SparseReward:
    """``QuadraticReward`` term by term, without those of weight zero: r ``[S]`` of scaled
    observations ``[S, n]`` and actions ``[S, m]``; its digits do not depend on S."""

    def __init__(self, reward: QuadraticReward) -> None:
        self._state = _terms(reward.state_cost)
        self._action = _terms(reward.action_cost)
        self.quadratic_form = reward.quadratic_form

    def __call__(self, observation: Tensor, action: Tensor) -> Tensor:
        """-(s' Q s + a' R a)."""
        cost = torch.zeros_like(observation[..., 0])
        for vector, terms in ((observation, self._state), (action, self._action)):
            for i, j, weight in terms:
                cost = cost + weight * vector[..., i] * vector[..., j]
        return -cost


def _terms(cost: Tensor) -> list[tuple[int, int, float]]:
    places = cost.nonzero().tolist()
    return [(i, j, float(cost[i, j])) for i, j in places]


@dataclass(frozen=True)
class Return:
    """Accumulates gamma^(t dt) dt r over the ticks t of an episode (an ``Accumulator``).

    discount: gamma, per second; dt: of a tick, in seconds.
    """

    reward: Reward
    discount: float
    dt: float
    deviation: float = 0.0
    kernel = "return_sums"

    @property
    def numbers(self) -> dict[str, float]:
        """See ``Accumulator``."""
        return {"LOG_DISCOUNT": math.log(self.discount)}

    def begin(self, episodes: int) -> tuple[Tensor, ...]:
        """The return so far, ``[S]``."""
        return (torch.zeros(episodes, dtype=torch.float64),)

    def add(self, sums: tuple[Tensor, ...], tick: EpisodeTick) -> tuple[Tensor, ...]:
        """One reward more."""
        earned = self.dt * self.reward(tick.observation, tick.action).to(torch.float64)
        if self.discount < 1:
            seconds = self.dt * tick.ticks.to(torch.float64)
            earned = earned * (math.log(self.discount) * seconds).exp()
        return (sums[0] + earned,)


def charge(seconds: Tensor, horizon: float, discount: float) -> Tensor:
    """What a reward of -1 per second amounts to from ``seconds`` ``[*batch]`` up to the horizon:
    minus the integral of gamma^t."""
    if discount == 1:
        return seconds - horizon
    rate = math.log(discount)
    return ((rate * seconds).exp() - math.exp(rate * horizon)) / rate


def check_discount(discount: float) -> None:
    """Raises ValueError unless it is in (0, 1]."""
    if not 0 < discount <= 1:
        raise ValueError(f"discount={discount}: expected a number in (0, 1] (per second)")
