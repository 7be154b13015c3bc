"""Which ticks are of free motion: without a stop or a strike that acts in them.

A model of free motion is fitted to these alone: an impulse elsewhere is not an acceleration, and
corrupts the mean accelerations of all rows.  Only what is told and read is used: stops whose levels
are known, and a component that counts strikes.
"""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops
from edtorch.model.strike import Strike
from edtorch.types import Transition

CLEAR = 4.0
"""Standard deviations of a gap's reading within which it may be zero."""


def free_ticks(
    transition: Transition, stops: Stops, strike: Strike | None, noise: Tensor
) -> Tensor:
    """``valid`` ``[N]`` without the ticks that an event may be in: a gap that is not clear of its
    stop at both ends, a strike.

    noise ``[n]``: standard deviations of readings, scaled.  A knee that hits and leaves its stop
    within a tick is near it at the end.
    """
    least = CLEAR * _gap_noise(stops, noise)
    clear = (stops.gaps(transition.state) > least) & (stops.gaps(transition.next_state) > least)
    free = transition.valid & clear.all(-1)
    if strike is not None:
        free = free & ~strike.happened(transition.state, transition.next_state)
    return free


def shut_stops(structure: Structure, stops: Stops, state: Tensor, noise: Tensor) -> Tensor:
    """Bool ``[N, K]``: the stops that readings ``[N, n]`` are at and at rest, within the noise."""
    by_rate = torch.from_numpy(stops.by_learned(structure))
    learned = torch.from_numpy(structure.learned)
    rate = state[:, learned] @ by_rate.mT
    most = CLEAR * (by_rate.square() @ noise[learned].square()).sqrt()
    return (stops.gaps(state) <= CLEAR * _gap_noise(stops, noise)) & (rate.abs() <= most)


def _gap_noise(stops: Stops, noise: Tensor) -> Tensor:
    """Standard deviations ``[K]`` of the gaps."""
    return (torch.from_numpy(stops.normal).square() @ noise.square()).sqrt()
