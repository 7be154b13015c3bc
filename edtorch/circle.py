"""Differences on the circle."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from edtorch.law import Law


class Circle:
    """period ``[n]``: of each component of a state, 0 for what does not wrap.  What its differences
    are divided by is found once: a policy asks at every tick."""

    def __init__(self, period: Tensor) -> None:
        self.period = period
        self._turn = torch.where(period > 0, period, torch.inf)

    def wrapped(self, difference: Tensor) -> Tensor:
        """Differences of states ``[*batch, n]``, those of angles within half a turn."""
        return difference - self.period * torch.round(difference / self._turn)

    def law(self) -> Law:
        """``wrapped`` on numpy."""
        period, turn = self.period.numpy(), self._turn.numpy()
        return lambda difference: difference - period * np.rint(difference / turn)


def wrapped(difference: Tensor, period: Tensor) -> Tensor:
    """``Circle.wrapped`` of a period ``[n]``."""
    return Circle(period).wrapped(difference)
