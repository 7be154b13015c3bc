"""Bounds of actions that a policy keeps by a smooth function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from edtorch.law import Law


@dataclass(frozen=True)
class Squash:
    """u = middle + half tanh(z), ``[*batch, m]``; middle, half ``[m]``: of the range of the
    actions, scaled."""

    middle: Tensor
    half: Tensor

    def __call__(self, raw: Tensor) -> Tensor:
        """The action of a raw one."""
        return self.middle + self.half * torch.tanh(raw)

    def law(self, raw: Law) -> Law:
        """Of raw actions by this law."""
        middle, half = self.middle.numpy(), self.half.numpy()
        return lambda state: middle + half * np.tanh(raw(state))

    def inverse(self, action: Tensor, gain: Tensor) -> tuple[Tensor, Tensor]:
        """Raw action ``[m]`` and raw gain ``[m, n]`` of a linear policy about an action: equal to
        first order.  An action at or beyond a bound is taken from just inside."""
        part = ((action - self.middle) / self.half).clamp(-0.99, 0.99)
        # u = middle + half tanh(z): du = half (1 - tanh(z)^2) dz.
        return part.atanh(), gain / (self.half * (1 - part.square())).unsqueeze(-1)
