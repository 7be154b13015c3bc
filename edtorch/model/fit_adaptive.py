"""Least squares for worlds that change: it doubts what it knows when its errors tell it to.

A fit of everything seen so far is the surer the longer it has lived, and after a change the slower.
Forgetting at a constant rate pays for that all the time, and where little excites the features it
forgets what it cannot learn again.  This fit watches its innovations instead, as a filter is
watched (Basseville & Nikiforov, "Detection of Abrupt Changes", 1993), and forgets when they grow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.fit import Fitted, RecursiveLeastSquares
from edtorch.shapes import Features, States, Weights
from edtorch.types import Parameters, each_learner


@dataclass(frozen=True)
class AdaptiveLeastSquares:
    """``RecursiveLeastSquares`` whose P grows by ``doubt`` I when the innovations do.

    Each output's squared innovation is divided by 1 + phi'P phi, the part that parameter
    uncertainty explains, and averaged over a short time (rate ``fast``) and a long one (``slow``).
    A short average ``threshold`` times the long one in some output is an alarm.  The long averages
    then begin anew from the short ones; for ten times the short one's memory nothing is an alarm,
    nor is it at the beginning.

    prior: as there; rates per second or per step, see ``edtorch.model.fit``.
    """

    prior: float = 1000.0
    fast: float = 5.0
    slow: float = 0.2
    threshold: float = 3.0
    doubt: float = 1.0
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        RecursiveLeastSquares(self.prior)
        if not self.fast > 0:
            raise ValueError(f"fast={self.fast}: expected a number > 0")
        if not 0 < self.slow < self.fast:
            raise ValueError(f"slow={self.slow}: expected a number > 0 and < fast, {self.fast}")
        if not self.threshold > 1:
            raise ValueError(f"threshold={self.threshold}: expected a number > 1")
        if not self.doubt > 0:
            raise ValueError(f"doubt={self.doubt}: expected a number > 0")

    def initial(self, weight: Tensor) -> Parameters:
        """P ``[*batch, k, k]``; the averages ``short`` and ``long`` ``[*batch, n]``; ``heard``
        ``[*batch]``, for how long the long ones have been listening; ``alarms`` ``[*batch]``, how
        often there has been one."""
        average = torch.zeros_like(weight[..., 0])
        none = torch.zeros_like(weight[..., 0, 0])
        return RecursiveLeastSquares(self.prior).initial(weight) | {
            "short": average,
            "long": average.clone(),
            "heard": none,
            "alarms": none.clone(),
        }

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """Look at the innovation, perhaps doubt, then learn from it."""
        P = memory["P"]
        innovation = y - matvec(weight, phi)
        explained = 1 + (phi * matvec(P, phi)).sum(-1, keepdim=True)
        squared = innovation.square() / explained
        heard = memory["heard"] + unit
        short = torch.lerp(
            memory["short"], squared, each_learner((self.fast * unit).clamp(max=1.0), squared.ndim)
        )
        # A plain mean until it is as long as its memory.
        share = torch.maximum(unit / heard, self.slow * unit).clamp(max=1.0).unsqueeze(-1)
        long = torch.lerp(memory["long"], squared, share)
        alarm = (short > self.threshold * long).any(-1) & (heard > 10 / self.fast)
        eye = torch.eye(P.shape[-1], dtype=P.dtype, device=P.device)
        doubted = P + (self.doubt * alarm.to(P.dtype)).unsqueeze(-1).unsqueeze(-1) * eye
        learned = RecursiveLeastSquares(self.prior).update(weight, {"P": doubted}, phi, y, unit)
        memory = learned.memory | {
            "short": short,
            "long": torch.where(alarm.unsqueeze(-1), short, long),
            # As long as the short average's memory.
            "heard": torch.where(alarm, 1 / self.fast, heard),
            "alarms": memory["alarms"] + alarm,
        }
        return Fitted(learned.weight, memory, learned.residual)
