"""What is odd about recorded transitions without contradicting anything, for people to look at.

Nothing is refused or left out for it.  All rows compared are those that are learned from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from edtorch.run.plausible import beyond_limits
from edtorch.run.recorded import Recorded, first_rows, last_rows, shorter_way
from sims.base import Spec

_SPIKE = 10.0
"""Times the usual change (95 % quantile) that a spike goes away and comes back."""
_ALONE = 20.0
"""Times the range of nine tenths of the values that a single value is away from their median."""
_TURNS = ((2 * math.pi, "2 pi"), (360.0, "360"))


class _Column(NamedTuple):
    """A component of state or action: its name, its values ``[N]``, its period or 0."""

    label: str
    values: np.ndarray
    period: float


def doubts(recorded: Recorded, spec: Spec) -> list[str]:
    """One line for each oddity, with numbers: columns that are constant, spikes, jumps of a whole
    turn, and a few states beyond the domain's limits."""
    if not recorded.valid.any():
        return []
    return [
        *_constant(recorded, spec),
        *_spikes(recorded, spec),
        *_turns(recorded, spec),
        *_few_beyond(recorded, spec),
    ]


def _constant(recorded: Recorded, spec: Spec) -> Iterator[str]:
    rows = recorded.valid
    size = int(rows.sum())
    if size < 2:
        return
    if not recorded.action[rows].any():
        yield (
            f"every action is 0 in all of {size} rows: nothing can be learned of what actions do"
        )
        kinds = [("state", spec.state)]
    else:
        kinds = [("state", spec.state), ("action", spec.action)]
    for kind, quantities in kinds:
        values = getattr(recorded, kind)[rows]
        for column, q in enumerate(quantities):
            if np.ptp(values[:, column]) == 0 and q.name not in spec.goal:
                yield (
                    f"{kind} {q.name} is {values[0, column]:g} in all of {size} rows: nothing can"
                    " be learned of what depends on it"
                )


def _columns(recorded: Recorded, spec: Spec) -> Iterator[_Column]:
    kinds = (("state", spec.state), ("action", spec.action), ("next_state", spec.state))
    for kind, quantities in kinds:
        for column, q in enumerate(quantities):
            yield _Column(f"{kind} {q.name}", getattr(recorded, kind)[:, column], q.period)


def _spikes(recorded: Recorded, spec: Spec) -> Iterator[str]:
    follows = ~first_rows(recorded.episode) & recorded.valid
    follows[1:] &= recorded.valid[:-1]
    inner = follows & np.append(follows[1:], False)
    for label, values, period in _columns(recorded, spec):
        found = _alone(values, recorded.valid) if period == 0 else np.zeros(len(values), bool)
        if label.startswith("next_state"):
            # Elsewhere it is the next row's state.
            found &= last_rows(recorded.episode)
        elif label.startswith("state"):
            found |= _there_and_back(values, period, inner)
        if found.any():
            row = int(np.flatnonzero(found)[0])
            rest = values[recorded.valid & ~found]
            yield (
                f"{label} has {_counted(found, 'spike')}, the first in row {row}:"
                f" {values[row]:g}, where the others are from {rest.min():g} to {rest.max():g}"
            )


def _there_and_back(values: np.ndarray, period: float, inner: np.ndarray) -> np.ndarray:
    """Rows that differ from the one before and the one after alike, far more than is usual."""
    found = np.zeros(len(values), dtype=bool)
    places = np.flatnonzero(inner)
    if len(places) == 0:
        return found
    turn = np.array([period])
    there = shorter_way((values[places] - values[places - 1])[:, None], turn)[:, 0]
    back = shorter_way((values[places + 1] - values[places])[:, None], turn)[:, 0]
    size = np.abs(np.concatenate([there, back]))
    if not size.any():
        return found
    usual = np.quantile(size, 0.95) or size[size > 0].min()
    smaller = np.minimum(np.abs(there), np.abs(back))
    found[places[(there * back < 0) & (smaller > _SPIKE * usual)]] = True
    return found


def _alone(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Rows that are far from all the others."""
    low, middle, high = np.quantile(values[valid], [0.05, 0.5, 0.95])
    return valid & (high > low) & (np.abs(values - middle) > _ALONE * (high - low))


def _turns(recorded: Recorded, spec: Spec) -> Iterator[str]:
    change = np.abs(recorded.next_state - recorded.state)[recorded.valid]
    places = np.flatnonzero(recorded.valid)
    for column, q in enumerate(spec.state):
        usual = np.quantile(change[:, column], 0.95)
        for turn, words in _TURNS:
            jumps = np.abs(change[:, column] - turn) <= 2 * usual + 1e-6 * turn
            if q.period > 0 or usual > turn / 10 or not jumps.any():
                continue
            row = int(places[jumps][0])
            yield (
                f"state {q.name} jumps by a whole turn ({words}) in"
                f" {_counted(jumps, 'row')}, the first row {row}: from"
                f" {recorded.state[row, column]:g} to {recorded.next_state[row, column]:g}; the"
                " domain does not declare it an angle that wraps"
            )


def _few_beyond(recorded: Recorded, spec: Spec) -> Iterator[str]:
    found = beyond_limits(recorded, spec) & recorded.valid[:, None]
    for column, q in enumerate(spec.state):
        if found[:, column].any():
            row = int(np.flatnonzero(found[:, column])[0])
            yield (
                f"state {q.name} is beyond the domain's limits in"
                f" {_counted(found[:, column], 'row')} where the episode does not end, the first"
                f" row {row}: {recorded.state[row, column]:g}, then"
                f" {recorded.next_state[row, column]:g}"
            )


def _counted(rows: np.ndarray, what: str) -> str:
    count = int(rows.sum())
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
