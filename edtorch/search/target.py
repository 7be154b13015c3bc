"""Mean starts on the circle, and the target states of a cost."""

from __future__ import annotations

from itertools import product

import numpy as np
import torch
from torch import Tensor

from edtorch.circle import wrapped
from edtorch.linalg import matvec
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure


def mean_start(starts: Tensor, period: Tensor) -> Tensor:
    """Mean ``[n]`` of readings ``[k, n]``; angles are averaged about the first one."""
    return starts[0] + wrapped(starts - starts[0], period).mean(0)


def wanted_states(structure: Structure, rows: np.ndarray, dt: float) -> Tensor:
    """The states ``[T + 1, n]`` with the least |R_t A(s)|^2 at each tick, R ``[T + 1, r, A]``.

    Gauss and Newton's method from every combination of quarter turns of the angles.  Of equally
    good states the one next to that of the tick before, at first the nearest to zero.  Rates that
    do not count are zero; what changes with time adds its derivative to its rate.
    """
    same = bool((rows == rows[:1]).all())
    good, states = _best(structure.lift, rows[:1] if same else rows)
    period, before, found = structure.period, torch.zeros_like(states[0, 0]), []
    for own, these in zip(good, states, strict=True):
        away = wrapped(these[own] - before, period)
        before = before + away[away.norm(dim=-1).argmin()]
        found.append(before)
    wanted = torch.stack(found)
    if same:
        return wanted.repeat(len(rows), 1)
    moving = torch.gradient(wanted, spacing=dt, dim=0)[0]
    for i in np.flatnonzero(structure.source >= 0):
        wanted[:, structure.source[i]] += moving[:, i] / structure.ratio[i]
    return wanted


def distances(
    structure: Structure, rows: np.ndarray, state: Tensor, goal: Tensor
) -> list[tuple[int, float]]:
    """(component, size of the difference of two states ``[n]``, angles the short way round), of the
    components that count in the rows ``[r, A]`` of a tick."""
    lift, away = structure.lift, structure.difference(state, goal).abs()
    entries = [(first, first + angle) for first, angle in zip(lift.at, lift.angle, strict=True)]
    return [(i, float(away[i])) for i, own in enumerate(entries) if np.any(rows[:, own])]


def _best(lift: Lift, rows: np.ndarray) -> tuple[Tensor, Tensor]:
    """Ends of the method, ``[T, q, n]``, and which of them are as good as any, bool ``[T, q]``."""
    angles = np.flatnonzero(lift.angle)
    quarters = np.array([*product(np.arange(-1, 3) * np.pi / 2, repeat=len(angles))])
    R = torch.from_numpy(np.ascontiguousarray(rows)).unsqueeze(1)
    state = torch.zeros(len(rows), len(quarters), lift.states, dtype=torch.float64)
    state[..., torch.from_numpy(angles)] = torch.from_numpy(quarters / lift.unit[angles])
    action = state.new_zeros(*state.shape[:-1], lift.actions)
    for _ in range(50):
        away = matvec(R, lift(state, action))
        slope = R @ lift.jacobian(state, action)[..., : lift.states]
        normal = slope.mT @ slope + 1e-9 * torch.eye(lift.states, dtype=torch.float64)
        step = torch.linalg.solve_ex(normal, slope.mT @ away.unsqueeze(-1)).result.squeeze(-1)
        state = state - step / (1 + step.norm(dim=-1, keepdim=True))
    square = matvec(R, lift(state, action)).square().sum(-1)
    return square <= square.min(-1, keepdim=True).values + 1e-6, state
