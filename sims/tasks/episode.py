"""What the tasks' rows share: normal starts, readings with wrapped angles, the clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from sims.base import Quantity
from sims.normal import normal_quantile_over
from sims.rows import Function, Namespace, joined


def normal_start_over(xp: Namespace, mean: Sequence[float], deviation: Sequence[float]) -> Function:
    """Independent normal numbers from uniforms, one each: a function of (state, uniforms,
    constants)."""
    quantile = normal_quantile_over(xp)

    def started(middle: float, spread: float, i: int) -> Function:
        return xp.jit(lambda s, u, c: (middle + spread * quantile(u[i]),))

    parts = zip(mean, deviation, strict=True)
    return joined(xp, *(started(*part, i) for i, part in enumerate(parts)))


def readings_over(xp: Namespace, quantities: Sequence[Quantity]) -> Function:
    """The first components of a state, those with a period within half of it from 0: a function of
    (state, constants)."""

    def seen(period: float, i: int) -> Function:
        if period == 0:
            return xp.jit(lambda s, c: (s[i],))

        @xp.jit
        def wrapped(s, c):
            value = s[i] - period * xp.floor(s[i] / period + 0.5)
            return (xp.maximum(xp.minimum(value, period / 2), -period / 2),)

        return wrapped

    return joined(xp, *(seen(quantity.period, i) for i, quantity in enumerate(quantities)))


def is_before(tick: Any, seconds: float, dt: float) -> Any:
    """Whether the tick is more than half a tick before ``seconds``: the product is rounded."""
    return tick * dt < seconds - dt / 2


def first_tick(seconds: float, dt: float) -> int:
    """The first tick that is not before ``seconds``."""
    return math.ceil(seconds / dt - 0.5)
