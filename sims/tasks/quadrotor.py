"""A quadrotor that hovers at the origin, with a thrust that has to be found."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sims.base import Outcome, Quantity, Spec, expect_action
from sims.tasks.integrate import runge_kutta

GRAVITY = 9.81
"""m/s^2."""
INERTIA = (0.01, 0.01, 0.02)
"""About the body's axes, kg m^2."""
TORQUES = (0.1, 0.1, 0.05)
"""Bounds about the body's axes, N m."""
FAR, TILT = 2.0, math.pi / 3
"""It crashes beyond these, m in each direction, and rad of roll or pitch."""

_POSITION, _SPEED, _ANGLE, _RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


class Quadrotor:
    """A rigid body of 1 kg with a thrust along its axis and three torques.

    ======== ==================================================================================
    state    position x, y, z (m, z up), velocity vx, vy, vz (m/s), roll, pitch, yaw (rad), and the
             rates p, q, r about the body's axes (rad/s)
    action   thrust (N, 0 to ``most_thrust`` times the weight), torques about the body's axes (N m)
    start    positions uniform within 0.1 m of the origin, everything else within 0.05
    end      crash beyond 2 m in a direction, or 60 degrees of roll or pitch
    ======== ==================================================================================
    """

    traceable = True

    def __init__(
        self, most_thrust: float = 2.0, dt: float = 0.02, time_limit: float = 10.0
    ) -> None:
        if not most_thrust > 1:
            raise ValueError(f"most_thrust={most_thrust}: expected a number > 1, to hover at all")
        if not dt > 0:
            raise ValueError(f"dt={dt}: expected a number > 0 (s)")
        most = most_thrust * GRAVITY
        self.spec = Spec(
            name="quadrotor",
            state=(
                *(Quantity(name, "m", limit=FAR) for name in ("x", "y", "z")),
                *(Quantity(f"v{name}", "m/s", rate_of=name) for name in ("x", "y", "z")),
                *(Quantity(name, "rad", limit=TILT) for name in ("roll", "pitch")),
                Quantity("yaw", "rad"),
                *(Quantity(name, "rad/s") for name in ("p", "q", "r")),
            ),
            action=(
                Quantity("thrust", "N", scale=most, low=0.0, high=most),
                *(
                    Quantity(f"torque_{name}", "N m", scale=bound, low=-bound, high=bound)
                    for name, bound in zip("xyz", TORQUES, strict=True)
                ),
            ),
            dt=dt,
            time_limit=time_limit,
            disturbance_dim=0,
            reset_dim=12,
            clip_action=True,
            headline="z",
        )

    def initial(self, uniforms: Tensor) -> Tensor:
        """``[*batch, 12]``."""
        size = torch.tensor([0.1] * 3 + [0.05] * 9, dtype=uniforms.dtype, device=uniforms.device)
        return size * (2 * uniforms - 1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """A new start where ``mask``."""
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """Two steps of Runge and Kutta's method."""
        expect_action(state, action, 4)
        return runge_kutta(lambda s: _derivative(s, action), state, self.spec.dt, 2)

    def observe(self, state: Tensor) -> Tensor:
        """All of the state."""
        return state

    def outcome(self, state: Tensor) -> Tensor:
        """``FAILED`` where it is too far away or too tilted."""
        near = (state[..., _POSITION].abs() <= FAR).all(-1)
        level = (state[..., 6:8].abs() <= TILT).all(-1)
        return torch.where(near & level, int(Outcome.RUNNING), int(Outcome.FAILED))

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """None."""
        return {}


def _derivative(state: Tensor, action: Tensor) -> Tensor:
    """ds/dt ``[*batch, 12]``: Newton's and Euler's equations, roll-pitch-yaw angles; action
    ``[*batch, 4]``."""
    roll, pitch, yaw = state[..., _ANGLE].unbind(-1)
    p, q, r = state[..., _RATE].unbind(-1)
    sr, cr, sp, cp = roll.sin(), roll.cos(), pitch.sin(), pitch.cos()
    sy, cy = yaw.sin(), yaw.cos()
    axis = torch.stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr], dim=-1)
    down = torch.tensor([0.0, 0.0, -GRAVITY], dtype=state.dtype, device=state.device)
    acceleration = axis * action[..., :1] + down
    turning = q * sr + r * cr
    angles = torch.stack([p + turning * pitch.tan(), q * cr - r * sr, turning / cp], dim=-1)
    inertia = torch.tensor(INERTIA, dtype=state.dtype, device=state.device)
    rate = state[..., _RATE]
    gyroscopic = torch.linalg.cross(rate, inertia * rate)
    return torch.cat(
        [state[..., _SPEED], acceleration, angles, (action[..., 1:] - gyroscopic) / inertia], dim=-1
    )
