"""Where the rider hung, read back from the states of a ride.

A state does not hold the rider's displacement, but the lean acceleration of a step tells it, given
the state before the step.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sims.bicycle.physics import RANDLOV, Physics


def displacement(
    trail: Tensor, *, physics: Physics = RANDLOV, side_force: Tensor | float = 0.0
) -> Tensor:
    """Displacement d + w ``[T-1]`` (m, disturbance included) of the steps of ``trail`` ``[T, 10]``.

    ``sims.bicycle.physics.step`` solved for d + w.  The states must be those of one step after the
    other; ``side_force`` ``[T-1]`` is the wind's in these steps, N.
    """
    p = physics
    theta, theta_dot, omega = trail[:-1, 0], trail[:-1, 1], trail[:-1, 2]
    sine, tangent = theta.sin(), theta.tan()
    behind = p.l - p.c
    centre = tangent / (tangent * tangent * (behind * behind) + p.l * p.l).sqrt()
    turning = (sine + tangent) * (p.M_d * p.r / p.l) + centre * (p.M * p.h)
    # I_B omega_ddot = weight sin(phi) - level cos(phi)
    level = theta_dot * (p.I_d * p.sigma_dot) + turning * (p.v * p.v) - side_force * p.h
    weight = torch.as_tensor(p.h * p.M * p.g, dtype=trail.dtype)
    share = (trail[1:, 4] * p.I_B / torch.hypot(weight, level)).clamp(-1, 1)
    phi = share.asin() + torch.atan2(level, weight)
    return (phi - omega).tan() * p.h
