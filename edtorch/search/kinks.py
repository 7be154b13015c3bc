"""The states just before and just after strikes, from the readings around them.

The free model, its stops held where the readings are at them, leads from the reading before a
strike forward and from the one after it backward in time.  Positions do not jump: the time of the
strike is that at which the two paths are nearest to each other.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from edtorch.model.event_free import shut_stops
from edtorch.model.impact import Kinks
from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops
from edtorch.model.strike import Strike
from edtorch.search.striking_program import striking_kernels
from edtorch.search.tick_model import TickModel, real, whole
from edtorch.types import Transition

NODES = 21
"""Of a path through a tick."""


def kinks_of(free: TickModel, strike: Strike, transition: Transition, noise: Tensor) -> Kinks:
    """The strikes among the valid rows of ``transition``, scaled.

    free: the model of free motion with its stops; noise ``[n]``: standard deviations of readings.
    Strikes whose paths are not finite are left out.
    """
    structure, stops = free.structure, free.stops or Stops.none(len(free.structure.source))
    rows = transition.valid & strike.happened(transition.state, transition.next_state)
    first, last, action = (
        part[rows] for part in (transition.state, transition.next_state, transition.action)
    )
    after_action = action[:, torch.from_numpy(strike.action_order)]
    shut = [shut_stops(structure, stops, state, noise) for state in (first, last)]
    ahead = strike.relabelled(_paths(free, first, action, shut[0], free.dt))
    back = _paths(free, last, after_action, shut[1], -free.dt).flip(1)
    before, after = _nearest(structure, ahead, back)
    kept = (before.isfinite() & after.isfinite()).all(-1)
    return Kinks(before[kept], after[kept], shut[1][kept])


def _paths(free: TickModel, state: Tensor, action: Tensor, shut: Tensor, seconds: float) -> Tensor:
    """``[N, NODES, n]``."""
    path = state.new_zeros(len(state), NODES, state.shape[-1]).numpy()
    bits = shut.numpy() @ (1 << np.arange(shut.shape[1]))
    given = real(torch.cat([state, action], -1).numpy()), whole(bits, np.int64)
    duration = real(state.new_full((len(state),), seconds).numpy())
    striking_kernels()["held_paths"](*given, duration, real(free.weight), free.parts, path)
    return torch.from_numpy(path)


def _nearest(structure: Structure, one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """The points ``[N, n]`` of two paths ``[N, Q, n]`` at the time of their nearest positions, each
    linear between its nodes."""
    positions = torch.from_numpy(structure.source >= 0)
    apart = structure.difference(other, one)[..., positions]
    change = apart[:, 1:] - apart[:, :-1]
    least = -(apart[:, :-1] * change).sum(-1) / change.square().sum(-1).clamp(min=1e-300)
    share = least.clamp(0, 1).unsqueeze(-1)
    distance = (apart[:, :-1] + share * change).square().sum(-1).nan_to_num(torch.inf)
    best = distance.argmin(-1)
    row = torch.arange(len(one))
    part = share[row, best]

    def at_best(path: Tensor) -> Tensor:
        return path[row, best] + part * (path[row, best + 1] - path[row, best])

    return at_best(one), at_best(other)
