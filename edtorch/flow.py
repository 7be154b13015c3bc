"""The flow of a differential equation over a while."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction


def flow(slope: StateFunction, state: Tensor, seconds: Tensor | float, steps: int = 2) -> Tensor:
    """The state ``[*batch, n]`` that ds/dt = ``slope``(s) leads to after ``seconds`` (a number or
    ``[*batch]``), in ``steps`` equal steps of Runge and Kutta's method of fourth order."""
    h = torch.as_tensor(seconds, dtype=state.dtype).unsqueeze(-1) / steps
    for _ in range(steps):
        first = slope(state)
        second = slope(state + h / 2 * first)
        third = slope(state + h / 2 * second)
        fourth = slope(state + h * third)
        state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    return state
