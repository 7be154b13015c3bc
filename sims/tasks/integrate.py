"""Runge and Kutta's method of fourth order over rows."""

from __future__ import annotations

from sims.rows import Function, Namespace, joined


def runge_kutta_over(xp: Namespace, derivative: Function, width: int, steps: int) -> Function:
    """A function of (state, given, dt): the state of ``width`` rows after ``dt`` seconds of ds/dt =
    ``derivative(state, given)``, in ``steps`` equal steps."""

    def moved(i: int) -> Function:
        return xp.jit(lambda s, h, slope: (s[i] + h * slope[i],))

    def mean(i: int) -> Function:
        return xp.jit(
            lambda h, s, a, b, c, d: (s[i] + h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]),)
        )

    along = joined(xp, *(moved(i) for i in range(width)))
    after = joined(xp, *(mean(i) for i in range(width)))

    @xp.jit
    def integrated(state, given, dt):
        h = dt / steps
        for _ in range(steps):
            first = derivative(state, given)
            second = derivative(along(state, h / 2, first), given)
            third = derivative(along(state, h / 2, second), given)
            fourth = derivative(along(state, h, third), given)
            state = after(h, state, first, second, third, fourth)
        return state

    return integrated
