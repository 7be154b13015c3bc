"""Differences on the circle."""

from __future__ import annotations

import torch
from torch import Tensor


def wrapped(difference: Tensor, period: Tensor) -> Tensor:
    """Differences of states ``[*batch, n]``, those of angles within half a turn; period ``[n]``: of
    each component, 0 for what does not wrap."""
    turns = torch.round(difference / torch.where(period > 0, period, torch.inf))
    return difference - period * turns
