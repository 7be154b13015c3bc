"""Runge and Kutta's method of fourth order for batches of states."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor


def runge_kutta(f: Callable[[Tensor], Tensor], state: Tensor, dt: float, steps: int) -> Tensor:
    """``state`` ``[*batch, n]`` after ``dt`` seconds of ds/dt = f(s), in ``steps`` equal steps."""
    h = dt / steps
    for _ in range(steps):
        first = f(state)
        second = f(state + h / 2 * first)
        third = f(state + h / 2 * second)
        fourth = f(state + h * third)
        state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    return state
