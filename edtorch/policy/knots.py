r"""A stationary policy of local linear ones.

    pi(s) = squash(sum_k phi_k(s) (z_k + K_k (s - s_k))),
    phi_k(s) = exp(-d_k^2 / 2 h^2) / sum_j exp(-d_j^2 / 2 h^2)

with d_k the distance of the knot k, in units of the scales of the state and shrunk by a factor of
its own.  It is linear in z and K: normalised radial basis functions times (1, s - s_k).  A width h
of zero takes the nearest knot.  Knots are the states of a plan, and the goal, whose distance is
shrunk so that it attracts what is near.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edtorch.circle import Circle
from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


@final
class KnotPolicy:
    """k = ``knots`` local policies.

    parameters: ``state`` ``[B, k, n]``, ``raw`` ``[B, k, m]``, ``gain`` ``[B, k, m, n]``,
    ``factor`` ``[B, k]`` of the distance.  width: h; metric ``[n]``: what divides a component in
    the distance, inf where it does not count; period ``[n]``: of angles, else 0.
    """

    label = "KnotPolicy"

    def __init__(
        self, knots: int, squash: Squash, period: Tensor, metric: Tensor, width: float = 0.1
    ) -> None:
        if knots < 1:
            raise ValueError(f"knots={knots}: expected at least one")
        if not width >= 0:
            raise ValueError(f"width={width}: expected a number >= 0")
        self.knots, self.squash, self.width = knots, squash, width
        self.circle, self.metric = Circle(period), metric

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """Knots at zero without any action."""
        B, k = len(seeds), self.knots
        n, m = len(self.circle.period), len(self.squash.half)
        like = self.circle.period
        return {
            "state": like.new_zeros(B, k, n),
            "raw": like.new_zeros(B, k, m),
            "gain": like.new_zeros(B, k, m, n),
            "factor": like.new_ones(B, k),
        }

    def features(self, parameters: Parameters, away: Tensor) -> Tensor:
        """phi of deviations from the knots: ``[*batch, k, n] -> [*batch, k]``."""
        squares = (away / self.metric).square().sum(-1) * parameters["factor"].square()
        if self.width == 0:
            nearest = squares.argmin(-1, keepdim=True)
            return torch.zeros_like(squares).scatter(-1, nearest, 1.0)
        return torch.softmax(-squares / (2 * self.width**2), dim=-1)

    def action(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """``[*more, B, n] -> [*more, B, m]``."""
        away = self.circle.wrapped(state.unsqueeze(-2) - parameters["state"])
        phi = self.features(parameters, away).unsqueeze(-1)
        local = parameters["raw"] + matvec(parameters["gain"], away)
        return self.squash((phi * local).sum(-2))

    def law(self, parameters: Arrays) -> Law:
        """``action`` of one state ``[n]`` (``edtorch.law``)."""
        knots, raws, gains = (parameters[name] for name in ("state", "raw", "gain"))
        metric, factor = self.metric.numpy(), np.square(parameters["factor"])
        width, wrapped = 2 * self.width**2, self.circle.law()
        flat = gains.swapaxes(0, 1).reshape(raws.shape[1], -1)

        def raw(state: NDArray[Any]) -> NDArray[Any]:
            away = wrapped(state - knots)
            squares = np.square(away / metric).sum(-1) * factor
            nearest = squares.argmin()
            if width == 0:
                return raws[nearest] + gains[nearest] @ away[nearest]
            phi = np.exp((squares[nearest] - squares) / width)
            phi /= phi.sum()
            return phi @ raws + flat @ (phi[:, None] * away).ravel()

        return self.squash.law(raw)
