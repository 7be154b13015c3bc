"""Mean starts on the circle, and the state that a cost wants."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from edtorch.model.lift import Lift
from edtorch.policy.squash import wrapped


def mean_start(starts: Tensor, period: Tensor) -> Tensor:
    """Mean ``[n]`` of readings ``[k, n]``; angles are averaged about the first one."""
    return starts[0] + wrapped(starts - starts[0], period).mean(0)


def wanted_state(lift: Lift, rows: np.ndarray) -> Tensor:
    """The state ``[n]`` with the least |R A(s)|^2, R ``[r, A]``; rates that do not count are zero.

    Gauss and Newton's method from every combination of quarter turns of the angles; the nearest to
    zero of equally good states.
    """
    angles = np.flatnonzero(lift.angle)
    quarters = np.stack(
        np.meshgrid(*[np.arange(-1, 3) * np.pi / 2] * len(angles), indexing="ij"), axis=-1
    ).reshape(-1, len(angles))
    state = torch.zeros(len(quarters), lift.states, dtype=torch.float64)
    state[:, torch.from_numpy(angles)] = torch.from_numpy(quarters / lift.unit[angles])
    action = state.new_zeros(len(state), lift.actions)
    R = torch.from_numpy(np.ascontiguousarray(rows))
    for _ in range(50):
        away = lift(state, action) @ R.mT
        slope = R @ lift.jacobian(state, action)[..., : lift.states]
        normal = slope.mT @ slope + 1e-9 * torch.eye(lift.states, dtype=torch.float64)
        step = torch.linalg.solve_ex(normal, slope.mT @ away.unsqueeze(-1)).result.squeeze(-1)
        state = state - step / (1 + step.norm(dim=-1, keepdim=True))
    square = (lift(state, action) @ R.mT).square().sum(-1)
    turn = torch.from_numpy(np.where(lift.angle, 2 * np.pi / lift.unit, 0.0))
    state = wrapped(state, turn)
    good = square <= square.min() + 1e-6
    return state[good][state[good].norm(dim=-1).argmin()]
