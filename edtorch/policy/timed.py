"""A policy that follows a plan: linear in the deviation from it, different at every tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import torch
from numpy.typing import NDArray
from torch import Tensor

from edtorch.circle import Circle
from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


@final
class TimedPolicy:
    """pi(s, t) = squash(z_t + K_t (s - s_t)), the plan being s_t, z_t and K_t.

    parameters: ``state`` ``[B, H + 1, n]``, ``raw`` z ``[B, H, m]``, ``gain`` K ``[B, H, m, n]``,
    scaled.  It takes states with the number of the tick appended ``[*more, B, n + 1]``
    (``edtorch.policy.clock.EpisodeClock``); after the horizon the last gain stays.  period
    ``[n]``: of angles, see ``edtorch.circle.Circle``.
    """

    label = "TimedPolicy"

    def __init__(self, horizon: int, squash: Squash, period: Tensor) -> None:
        if horizon < 1:
            raise ValueError(f"horizon={horizon}: expected at least one tick")
        self.horizon = horizon
        self.squash = squash
        self.circle = Circle(period)

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """A plan that stays at zero without any action, one for each seed."""
        B, H = len(seeds), self.horizon
        n, m = len(self.circle.period), len(self.squash.half)
        like = self.circle.period
        return {
            "state": like.new_zeros(B, H + 1, n),
            "raw": like.new_zeros(B, H, m),
            "gain": like.new_zeros(B, H, m, n),
        }

    def action(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """``[*more, B, n + 1] -> [*more, B, m]``."""
        state, ticks = state[..., :-1], state[..., -1]
        tick = ticks.long().clamp(0, self.horizon - 1)
        row = torch.arange(tick.shape[-1], device=tick.device)
        away = self.circle.wrapped(state - parameters["state"][row, tick])
        return self.squash(
            parameters["raw"][row, tick] + matvec(parameters["gain"][row, tick], away)
        )

    def law(self, parameters: Arrays) -> Law:
        """``action`` of one state ``[n + 1]`` (``edtorch.law``)."""
        plan, raws, gains = (parameters[name] for name in ("state", "raw", "gain"))
        last, wrapped = self.horizon - 1, self.circle.law()

        def raw(state: NDArray[Any]) -> NDArray[Any]:
            tick = min(max(int(state[-1]), 0), last)
            return raws[tick] + gains[tick] @ wrapped(state[:-1] - plan[tick])

        return self.squash.law(raw)
