"""Whether recorded transitions contradict themselves or the domain, row by row.

Each function looks for one kind of fault and returns the rows that have it.  They compare a row
with the other rows of the file, so they take the rows whose numbers are sound (``sound`` ``[N]``);
nothing is found in files that are too short to tell.
"""

from __future__ import annotations

import math

import numpy as np

from edtorch.run.recorded import Recorded, first_rows, last_rows, shorter_way
from sims.base import Spec

FACTOR = 10.0
"""Of the domain's time step, by which a row's is taken for one in another unit."""
FEW = 0.01
"""Share of the rows that may be beyond the domain's limits: outliers, not another unit."""
_FAR = 5.0
"""Times the 99 % quantile of the other rows' residuals that a jump to another episode exceeds."""
_CHANCE = 1e-6
"""Probability at which so many large residuals at the ends of episodes are no coincidence."""
_SLACK = 0.01
"""Of the range of a component of the state, by which a simulator may exceed its bounds."""


def periods(spec: Spec) -> np.ndarray:
    """``[n]``: of the components of the state, 0 where they have none."""
    return np.array([q.period for q in spec.state])


def off_the_clock(recorded: Recorded, spec: Spec) -> np.ndarray:
    """Rows whose time step is ten times the domain's, or a tenth of it, or farther off."""
    ratio = recorded.dt / spec.dt
    found = (ratio >= FACTOR * (1 - 1e-9)) | (ratio <= (1 + 1e-9) / FACTOR)
    return found & np.isfinite(ratio) & (ratio > 0)


def beyond_limits(recorded: Recorded, spec: Spec) -> np.ndarray:
    """``[N, n]``: where the state is beyond the domain's limits in a row that such an episode does
    not have: it begins there, or goes on from there."""
    goes_on = ~(recorded.terminated | recorded.truncated)
    return _beyond(recorded.state, spec) | (_beyond(recorded.next_state, spec) & goes_on[:, None])


def _beyond(state: np.ndarray, spec: Spec) -> np.ndarray:
    found = np.zeros(state.shape, dtype=bool)
    for column, q in enumerate(spec.state):
        values = state[:, column]
        found[:, column] = np.abs(values) > q.limit * (1 + 1e-6)
        if q.period == 0 and math.isfinite(q.high - q.low):
            room = _SLACK * (q.high - q.low)
            found[:, column] |= (values > q.high + room) | (values < q.low - room)
    return found


def foreign_ends(recorded: Recorded, spec: Spec, rounding: float, sound: np.ndarray) -> np.ndarray:
    """Last rows of episodes whose ``next_state`` is the first state of another episode.

    That is so in a continuous log that was cut into windows as well, where it follows from the
    state before.  So a linear model of the change is fitted to the other rows, and only the ends
    that are far off it are returned: farther than any other row by a factor, or too many of them
    to be a coincidence; all of them if most are.  rounding: relative, of the file's numbers.
    """
    here = _at_another_start(recorded, spec, rounding) & sound
    others = sound & ~here
    if not here.any() or others.sum() < 2 * (
        2 + recorded.state.shape[1] + recorded.action.shape[1]
    ):
        return np.zeros(len(recorded), dtype=bool)
    residual = np.abs(residuals(recorded, spec, others))
    scale = np.array([q.scale for q in spec.state])
    least = rounding * (scale + np.abs(recorded.state[others]).max(0))
    usual = np.maximum(np.quantile(residual[others], 0.99, axis=0), least)
    size = (residual / usual).max(-1)
    if _mostly(size > 1, here, others, 0.5):
        return here
    far = size > _FAR
    many = _mostly(far, here, others, 0.0)
    return here & (far if many else size > _FAR * max(1.0, float(size[others].max())))


def _mostly(large: np.ndarray, here: np.ndarray, others: np.ndarray, share: float) -> bool:
    """Whether at least this share of the rows ``here`` are ``large``, and so many more than of the
    others that it is no coincidence."""
    found, size = int(large[here].sum()), int(here.sum())
    rate = float((1 + large[others].sum()) / others.sum())
    return found >= share * size and _tail(found, size, rate) < _CHANCE


def _at_another_start(recorded: Recorded, spec: Spec, rounding: float) -> np.ndarray:
    """Last rows that end where an episode begins, most often the next one."""
    starts = recorded.state[first_rows(recorded.episode)]
    last = np.flatnonzero(last_rows(recorded.episode))
    ends = recorded.next_state[last]
    gap = np.abs(shorter_way(ends - np.roll(starts, -1, axis=0), periods(spec)))
    scale = np.array([q.scale for q in spec.state])
    known = {start.tobytes() for start in starts}
    # NaN is never close.
    close = (gap <= rounding * (scale + np.abs(ends))).all(-1)
    close |= np.array([end.tobytes() in known for end in ends])
    found = np.zeros(len(recorded), dtype=bool)
    found[last[close]] = True
    return found


def residuals(recorded: Recorded, spec: Spec, rows: np.ndarray) -> np.ndarray:
    """``[N, n]``: by how much the change of the state differs from a linear model of state and
    action, fitted to most of ``rows``: those that are far off are left out of the fit."""
    dt = recorded.dt[:, None]
    change = shorter_way(recorded.next_state - recorded.state, periods(spec))
    given = np.concatenate([recorded.state, recorded.action], axis=1)
    middle, spread = np.median(given[rows], axis=0), np.ptp(given[rows], axis=0)
    regressor = (given - middle) / np.where(spread > 0, spread, 1.0)
    regressor = np.concatenate([regressor, np.ones((len(given), 1))], axis=1)
    low, high = np.quantile(given[rows], [0.05, 0.95], axis=0)
    near = rows & (np.abs(given - middle) <= FACTOR * (high - low) + 1e-12).all(-1)
    found = change
    for _ in range(3):
        weight, *_ = np.linalg.lstsq(regressor[near], (change / dt)[near], rcond=None)
        found = change - dt * (regressor @ weight)
        bound = _FAR * np.quantile(np.abs(found[near]), 0.95, axis=0)
        near = near & (np.abs(found) <= bound).all(-1)
    return found


def _tail(least: int, size: int, rate: float) -> float:
    """Probability of ``least`` or more of ``size`` independent events with this rate each."""
    if least == 0 or rate >= 1:
        return 1.0
    logs = [
        math.lgamma(size + 1)
        - math.lgamma(k + 1)
        - math.lgamma(size - k + 1)
        + k * math.log(rate)
        + (size - k) * math.log1p(-rate)
        for k in range(least, size + 1)
    ]
    return math.fsum(math.exp(log) for log in logs)
