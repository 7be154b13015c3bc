"""Motion through events over rows: a step that stops where a guard is crossed."""

from __future__ import annotations

from sims.rows import Function, Namespace, joined

NEWTON = 6
"""Steps to the root of a guard's cubic."""


def events_over(
    xp: Namespace,
    move: Function,
    gaps: Function,
    land: Function,
    *,
    width: int,
    guards: int,
    substeps: int,
    events: int,
) -> Function:
    """A function of (state, dt): the state of ``width`` rows after ``dt`` seconds of ``move``,
    interrupted by up to ``events`` events.

    ``move(state, seconds)``: motion without events.  ``gaps(state)``: of each of the ``guards`` its
    gap and the gap's rate, one after the other; an event is where a gap becomes negative, falling.
    ``land(state, guard)``: the state after the event of ``guard``, a row, -1 where there is none.

    Substeps of dt / ``substeps``.  One that ends beyond a guard is thrown away and repeated up to
    the root of the cubic with the gap and its rate at both ends, so each event takes two pieces
    more than the substeps.  The last piece takes all time that is left, without events, so that
    time always advances by ``dt``; what it crosses is an event at the start of the next call.
    """
    pieces = substeps + 2 * events
    chosen = joined(
        xp, *(xp.jit(lambda mask, a, b, i=i: (xp.where(mask, a[i], b[i]),)) for i in range(width))
    )
    first = _first_over(xp, guards)

    @xp.jit
    def passed(state, dt):
        nothing = 0.0 * state[0]
        left, ahead = nothing + dt, nothing + dt / substeps
        # Of the piece that begins: the guard that it goes up to, if any, and how many are left.
        guard, spare = nothing - 1.0, nothing + float(pieces)
        for _ in range(pieces):
            last = spare < 1.5
            length = xp.where(last, left, xp.minimum(ahead, left))
            trial = move(state, length)
            part, crossed = first(gaps(state), gaps(trial), length)
            arrives = xp.both(guard > -0.5, xp.negated(last))
            thrown = xp.both(crossed > -0.5, xp.negated(xp.either(arrives, last)))
            landed = land(trial, xp.where(arrives, guard, -1.0))
            state = chosen(thrown, state, landed)
            left = xp.where(thrown, left, left - length)
            ahead = xp.where(thrown, part * length, dt / substeps)
            guard = xp.where(thrown, crossed, -1.0)
            spare = spare - 1.0
        return state

    return passed


def _first_over(xp: Namespace, guards: int) -> Function:
    """A function of (gaps and rates before, the same after, seconds between): the fraction of the
    time at which the first guard is crossed, and that guard, -1 if none is."""
    root = _root_over(xp)

    @xp.jit
    def first(before, after, length):
        nothing = 0.0 * length
        earliest, guard = nothing + 2.0, nothing - 1.0
        for i in range(guards):
            gap, rate = before[2 * i], before[2 * i + 1]
            end, end_rate = after[2 * i], after[2 * i + 1]
            crossed = xp.both(end < 0.0, end_rate < 0.0)
            part = root(gap, rate * length, end, end_rate * length)
            sooner = xp.both(crossed, part < earliest)
            earliest, guard = xp.where(sooner, part, earliest), xp.where(sooner, float(i), guard)
        return earliest, guard

    return first


def _root_over(xp: Namespace) -> Function:
    """Where in [0, 1] the cubic with these values and slopes at 0 and 1 becomes negative, 0 if it
    is about to at 0: by Newton's method from 1, with bisection where that leaves the bracket."""

    @xp.jit
    def root(a, slope_a, b, slope_b):
        # a + x (slope_a + x (square + x cube)).
        square = 3.0 * (b - a) - 2.0 * slope_a - slope_b
        cube = 2.0 * (a - b) + slope_a + slope_b
        low = 0.0 * a
        x, high = low + 1.0, low + 1.0
        for _ in range(NEWTON):
            value = a + x * (slope_a + x * (square + x * cube))
            slope = slope_a + x * (2.0 * square + 3.0 * x * cube)
            beyond = value < 0.0
            low, high = xp.where(beyond, low, x), xp.where(beyond, x, high)
            ahead = x - value / xp.where(slope < 0.0, slope, -1.0)
            inside = xp.both(ahead >= low, ahead <= high)
            x = xp.where(xp.both(inside, slope < 0.0), ahead, 0.5 * (low + high))
        return xp.where(xp.either(a > 0.0, slope_a > 0.0), x, 0.0)

    return root
