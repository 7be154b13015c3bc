"""What a reward wants at each tick: values that a component, or a place, is to follow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

_WAVE = {"amplitude", "period"}


def reference_values(told: Any, ticks: int, dt: float) -> Tensor:
    """``[ticks + 1]``, from the start of an episode on, a tick being ``dt`` seconds.

    told: the values themselves, one a tick, of which the last one stays; or ``amplitude`` a and
    ``period`` P (s) of a sin(2 pi t / P).  Raises ValueError, which begins with ``reference``.
    """
    if isinstance(told, Mapping) and set(told) == _WAVE:
        amplitude, period = float(told["amplitude"]), float(told["period"])
        if not (math.isfinite(amplitude) and 0 < period < math.inf):
            raise ValueError(f"reference={dict(told)}: expected finite numbers, period > 0")
        seconds = dt * torch.arange(ticks + 1, dtype=torch.float64)
        return amplitude * torch.sin(2 * math.pi / period * seconds)
    if not isinstance(told, Sequence) or isinstance(told, str) or not told:
        raise ValueError(
            f"reference={told}: expected amplitude and period, or a list of values, one a tick"
        )
    values = torch.tensor([float(value) for value in told], dtype=torch.float64)
    if not bool(values.isfinite().all()):
        raise ValueError("reference: expected finite values")
    return values[torch.arange(ticks + 1).clamp(max=len(values) - 1)]
