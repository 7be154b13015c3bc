"""Where stops are, and a model of free motion from the ticks between their hits.

A hit changes a rate at once.  A smooth model fitted to such ticks is wrong everywhere, so they are
found first, by regressions from which outliers are left out, a few times (trimming; Rousseeuw &
Leroy, "Robust regression and outlier detection", 1987).  An outlier whose rate is pushed the way
that a stop pushes says where that stop is: a rod that was hit either lies there at the end of the
tick, or has left it with the acceleration of free motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import Contradicted, FitError
from edtorch.model.evidence import Posterior
from edtorch.model.mechanism import Structure, accelerations, runge_kutta
from edtorch.model.path_fit import LEAST_ROWS, usable
from edtorch.model.stops import Stops
from edtorch.types import Transition

_OUTLYING = 6.0
"""Robust standard deviations of a rate's change beyond which a tick has an event."""
_ROUNDS = 4
"""Of trimming."""
_MARGIN = 4.0
"""Standard deviations of readings within which a position is at a stop."""
_FEW = 0.1
"""Share of the readings from which those beyond a told level are no outliers."""
_NORMAL = 1.483
"""Standard deviation over the median of |x|, of a normal distribution."""


@dataclass(frozen=True, eq=False)
class Events:
    """stops: those that were hit, or whose level is told; free: bool ``[N]``, valid transitions
    without an event; notes: for people."""

    stops: Stops
    free: Tensor
    notes: tuple[str, ...]


def find_events(
    structure: Structure,
    stops: Stops,
    transition: Transition,
    fit: Callable[[Structure, Transition], Posterior],
) -> Events:
    """The levels of ``stops`` and the ticks between hits, from N transitions, scaled.

    Without a free tick more than ``LEAST_ROWS``, all valid ones count as free and there are no
    stops, which the notes say.  Raises FitError where readings lie beyond a stop whose level is
    told, Contradicted where these are more than a few, and what ``fit`` raises.
    """
    data = usable(transition)
    weight, outlying, error = _trimmed(structure, data, fit)
    margin = _margin(structure, stops, error[~outlying])
    ahead = torch.from_numpy(stops.by_learned(structure))
    learned = torch.from_numpy(structure.learned)
    pushed = error[:, learned] @ ahead.mT
    level, notes = stops.level.copy(), list[str]()
    for k, name in enumerate(stops.names):
        if np.isnan(level[k]):
            hit = outlying & (pushed[:, k] > 0)
            level[k] = _level(structure, stops, k, weight, data, hit, float(margin[k]))
            if np.isnan(level[k]):
                notes.append(f"told.stops.{name}: no transition crosses it; not modelled yet")
    kept = ~np.isnan(level)
    found = replace(stops, level=level).kept(kept)
    near = margin[torch.from_numpy(kept)]
    start, end = found.gaps(data.state), found.gaps(data.next_state)
    beyond = end < -2 * near
    for k, name in enumerate(found.names):
        if count := int(beyond[:, k].sum()):
            farthest = float(-end[:, k].min()) * found.unit[k]
            kind = Contradicted if count >= _FEW * len(end) else FitError
            raise kind(
                f"told.stops.{name}.at={found.physical[k]:g}: {count} of {len(end)} readings lie"
                f" beyond it, by up to {farthest:.3g}; is the level right?"
            )
    free = ~outlying & (start > near).all(-1) & (end > near).all(-1)
    if int(free.sum()) < 2 * LEAST_ROWS:
        notes.append(
            f"told.stops: {int(free.sum())} of {len(free)} ticks are free of hits, too few for a"
            " model of their own; one smooth model of all of them"
        )
        return Events(found.kept(np.zeros(len(found), bool)), transition.valid, tuple(notes))
    for k, name in enumerate(found.names):
        if np.isnan(stops.level[stops.names.index(name)]):
            notes.append(f"told.stops.{name}.at=null: learned at {found.physical[k]:.4g}")
    whole = transition.valid.clone()
    whole[transition.valid] = free
    return Events(found, whole, tuple(notes))


def _trimmed(
    structure: Structure, data: Transition, fit: Callable[[Structure, Transition], Posterior]
) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of free motion, which rows are outlying ``[N]``, and one-tick errors ``[N, n]``."""
    outlying = torch.zeros_like(data.valid)
    learned = torch.from_numpy(structure.learned)

    def fitted() -> tuple[Tensor, Tensor]:
        weight = fit(structure, replace(data, valid=~outlying)).weight
        ahead = runge_kutta(structure, weight, data.state, data.action, data.dt)
        return weight, structure.difference(data.next_state, ahead).nan_to_num(1e6)

    weight, error = fitted()
    for _ in range(_ROUNDS):
        size = error[:, learned].abs()
        usual = _NORMAL * size[~outlying].median(0).values
        last, outlying = outlying, (size > _OUTLYING * usual + 1e-9).any(-1)
        if bool((outlying == last).all()) or int((~outlying).sum()) < LEAST_ROWS:
            return weight, last, error
        weight, error = fitted()
    return weight, outlying, error


def _margin(structure: Structure, stops: Stops, error: Tensor) -> Tensor:
    """``[K]``: that far from a stop, readings may be at it; error: of free ticks."""
    deviation = _NORMAL * error.abs().median(0).values / 2**0.5
    normal = torch.from_numpy(stops.normal)
    return _MARGIN * (normal.square() @ deviation.square()).sqrt() + 1e-6


def _level(
    structure: Structure,
    stops: Stops,
    k: int,
    weight: Tensor,
    data: Transition,
    hit: Tensor,
    margin: float,
) -> float:
    """The level of stop k by the ticks in which it may have been hit, nan if there is none.

    A stop beyond which readings lie is none.
    """
    if not bool(hit.any()):
        return np.nan
    normal = torch.from_numpy(stops.normal[k])
    ahead = torch.from_numpy(stops.by_learned(structure)[k])
    learned = torch.from_numpy(structure.learned)
    end, action = data.next_state[hit], data.action[hit]
    rate = (end[:, learned] @ ahead).clamp(min=0)
    rise = accelerations(structure, weight, end, action) @ ahead
    since = torch.where(rise > 0, rate.square() / (2 * rise.clamp(min=1e-9)), 0 * rate)
    levels = end @ normal - since
    turn = float(stops.turn[k])
    if turn:
        levels = levels[0] + torch.remainder(levels - levels[0] + turn / 2, turn) - turn / 2
    readings = torch.cat([data.state[:1], data.next_state])
    possible = [
        float(at)
        for at in levels
        if float(_gaps_at(stops, k, float(at), readings).min()) > -2 * margin
    ]
    return float(np.median(possible)) if possible else np.nan


def _gaps_at(stops: Stops, k: int, level: float, state: Tensor) -> Tensor:
    one = np.arange(len(stops)) == k
    return replace(stops.kept(one), level=np.array([level])).gaps(state)[:, 0]
