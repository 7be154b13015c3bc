"""Where a belief comes from: a state, a mean and covariance, or data (section 3's s'_0)."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.errors import NonFiniteError, ShapeError
from edtorch.shapes import States
from edtorch.types import Belief


def point_belief(state: States) -> Belief:
    """All probability at ``state`` ``[*batch, n]`` (Fig. 1, steps 3 and 4)."""
    n = state.shape[-1]
    return Belief(state, torch.zeros(*state.shape, n, dtype=state.dtype, device=state.device))


def data_belief(states: Tensor) -> Belief:
    """s'_0 = (E_D[s], cov_D[s]) (section 3), D being the law of N recorded states, each 1/N.

    states ``[*batch, N, n]``, N >= 1.  The covariance is that of D itself, divided by N: one state
    is a point belief.  Raises ShapeError without a state, NonFiniteError with a bad one.
    """
    if states.ndim < 2 or states.shape[-2] < 1:
        raise ShapeError(
            f"states have shape {tuple(states.shape)}, expected [*batch, N, n] with N >= 1"
        )
    if not bool(states.isfinite().all()):
        row = (~states.isfinite()).nonzero()[0].tolist()
        raise NonFiniteError(
            f"states{row} is {states[tuple(row)].item()}, expected a finite number"
        )
    mean = states.mean(-2)
    centred = states - mean.unsqueeze(-2)
    return Belief(mean, centred.mT @ centred / states.shape[-2])
