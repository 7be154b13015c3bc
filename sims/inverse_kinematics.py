"""Inverse kinematics by damped least squares (Levenberg and Marquardt), batched.

From each of several starts q,

    q <- q + (J' J + lambda I)^-1 J' e

where J is the geometric Jacobian and e the remaining error: position, m, and rotation vector, rad.
A step is taken if it reduces the error, and lambda is reduced; otherwise lambda grows.  Joints are
clamped to their ranges; a joint that can turn all the way continues at the other end of its range.
The answer to a target does not depend on the other targets.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

_STARTS, _ROUNDS = 8, 8
"""Starts of a round, and rounds at most."""
_STEPS = 60
"""Steps from each start at most."""
_TARGETS = 1024
"""Targets at a time, which bounds the memory."""

Kinematics = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Joints ``[R, n]`` to the pose of the end ``[R, 4, 4]`` and its Jacobian ``[R, 6, n]``."""


def solve(
    kinematics: Kinematics,
    targets: Tensor,
    low: Tensor,
    high: Tensor,
    turning: Tensor,
    enough: float,
) -> tuple[Tensor, Tensor]:
    """Joints ``[N, n]`` for finite ``targets`` ``[N, 4, 4]`` and how far each leaves the end from
    its target, ``[N]``, the larger of m and rad.

    low, high ``[n]``: ranges, which may be infinite; turning ``[n]``: which joints are revolute and
    their positions a whole turn apart the same; enough: the distance that ends the search.
    """
    low, high = _within_a_turn(low, high, turning)
    starts = _starts(low, high)
    joints = starts[0].expand(len(targets), -1).clone()
    off = torch.full((len(targets),), torch.inf, dtype=torch.float64)
    for some in torch.arange(len(targets)).split(_TARGETS):
        for of_round in starts.split(_STARTS):
            left = some[off[some] > enough]
            if len(left) == 0:
                break
            found, missed = _descend(
                kinematics, targets[left], of_round, low, high, turning, enough
            )
            better = missed < off[left]
            joints[left[better]], off[left[better]] = found[better], missed[better]
    return joints, off


def _error(poses: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """The error between poses and targets ``[*batch, 4, 4]``: position and rotation vector
    ``[*batch, 6]``, and the rotation's angle ``[*batch]``.

    At exactly half a turn the vector's direction is undefined: it is 0, and only the angle tells.
    """
    turn = targets[..., :3, :3] @ poses[..., :3, :3].mT
    vector = 0.5 * torch.stack(
        (
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ),
        -1,
    )
    sine = vector.norm(dim=-1)
    angle = torch.atan2(sine, 0.5 * (turn.diagonal(dim1=-2, dim2=-1).sum(-1) - 1))
    vector = vector * (angle / sine.clamp(min=1e-300)).unsqueeze(-1)
    shift = targets[..., :3, 3] - poses[..., :3, 3]
    return torch.cat((shift, vector), -1), angle


def _miss(error: Tensor, angle: Tensor) -> Tensor:
    """The larger of the distances along the axes, m, and the angle, rad."""
    return torch.maximum(error[..., :3].abs().amax(-1), angle)


def _descend(
    kinematics: Kinematics,
    targets: Tensor,
    starts: Tensor,
    low: Tensor,
    high: Tensor,
    turning: Tensor,
    enough: float,
) -> tuple[Tensor, Tensor]:
    """Where the first start to reach each target arrives, or else the one that ends nearest."""
    count, n = len(targets), starts.shape[-1]
    targets = targets.repeat_interleave(len(starts), 0)
    q = starts.repeat(count, 1)
    pose, J = kinematics(q)
    error, angle = _error(pose, targets)
    cost = error[:, :3].square().sum(-1) + angle.square()
    damping = torch.full_like(cost, 1e-2)
    eye = torch.eye(n, dtype=q.dtype)
    for _ in range(_STEPS):
        done = (_miss(error, angle) < enough).view(count, -1).any(-1)
        if bool(done.all()):
            break
        slope = (J.mT @ error.unsqueeze(-1)).squeeze(-1)
        stuck = ~turning & (((q <= low) & (slope < 0)) | ((q >= high) & (slope > 0)))
        free = J.masked_fill(stuck.unsqueeze(-2), 0.0)
        normal = free.mT @ free + damping[:, None, None] * eye
        step = torch.linalg.solve_ex(normal, slope.masked_fill(stuck, 0.0)).result
        ahead = _inside(q + step, low, high, turning)
        pose, J_ahead = kinematics(ahead)
        error_ahead, angle_ahead = _error(pose, targets)
        cost_ahead = error_ahead[:, :3].square().sum(-1) + angle_ahead.square()
        better = (cost_ahead < cost) & ~done.repeat_interleave(len(starts))
        q = torch.where(better[:, None], ahead, q)
        J = torch.where(better[:, None, None], J_ahead, J)
        error = torch.where(better[:, None], error_ahead, error)
        angle, cost = torch.where(better, angle_ahead, angle), torch.where(better, cost_ahead, cost)
        damping = (damping * torch.where(better, 0.2, 4.0)).clamp(1e-9, 1e9)
    missed = _miss(error, angle)
    rows = missed.view(count, -1)
    reached = rows < enough
    best = torch.where(reached.any(-1), reached.double().argmax(-1), rows.argmin(-1))
    best = best + len(starts) * torch.arange(count)
    return q[best], missed[best]


def _within_a_turn(low: Tensor, high: Tensor, turning: Tensor) -> tuple[Tensor, Tensor]:
    """The ranges, where ``turning`` cut to 2 pi, about 0 or as near to it as they allow."""
    middle = torch.zeros_like(low).clamp(low + math.pi, high - math.pi)
    return (
        torch.where(turning, torch.maximum(low, middle - math.pi), low),
        torch.where(turning, torch.minimum(high, middle + math.pi), high),
    )


def _starts(low: Tensor, high: Tensor) -> Tensor:
    """The middle of the ranges and random positions in them, ``[_STARTS _ROUNDS, n]``."""
    low, high = _within_a_turn(low, high, torch.ones_like(low, dtype=torch.bool))
    generator = torch.Generator().manual_seed(0)
    share = torch.rand(_STARTS * _ROUNDS, len(low), generator=generator, dtype=torch.float64)
    share[0] = 0.5
    return low + (high - low) * share


def _inside(q: Tensor, low: Tensor, high: Tensor, turning: Tensor) -> Tensor:
    around = low + torch.remainder(q - low, 2 * math.pi)
    return torch.where(turning, around, q).clamp(low, high)
