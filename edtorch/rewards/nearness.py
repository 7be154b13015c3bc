r"""PILCO's reward of what is linear in the lift of the state, such as the place of a rod's tip.

    r(s) = exp(-1/2 sum_k w_k (sum_e R_ke A_e(s))^2)

A(s) has sine and cosine of every angle (``edtorch.rewards.lifted``).  It is between 0 and 1, and 1
at the target (Deisenroth & Rasmussen, "PILCO", 2011, eq. 25, is 1 - r).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from edtorch.rewards.lifted import LiftedReward
from edtorch.shapes import Actions, Rows, States
from sims.base import Spec


class NearnessReward:
    """rows, angles: as of ``LiftedReward``; weight 1 / width^2 for a width in the unit of the row.

    ValueError for a row with a reference, and as there.
    """

    def __init__(
        self,
        spec: Spec,
        rows: Sequence[Mapping[str, Any]],
        angles: Sequence[str] = (),
        dtype: torch.dtype = torch.float64,
    ) -> None:
        self._squares = LiftedReward(spec, rows, angles=angles, dtype=dtype)
        if self._squares.timed:
            raise ValueError("rows: expected none with a reference")

    def __call__(self, state: States, action: Actions, /) -> Rows:
        """``[*batch]`` of physical states ``[*batch, n]``; actions ``[*batch, m]`` do not count."""
        return torch.exp(0.5 * self._squares(state, action))
