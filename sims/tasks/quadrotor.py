"""A quadrotor that hovers at the origin, with a thrust that has to be found."""

from __future__ import annotations

import math

from torch import Tensor

from sims.base import Outcome, Quantity, Spec
from sims.rows import Function, Namespace, Rows, RowSim, joined
from sims.tasks.integrate import runge_kutta_over

RUNNING, FAILED = int(Outcome.RUNNING), int(Outcome.FAILED)

GRAVITY = 9.81
"""m/s^2."""
INERTIA = (0.01, 0.01, 0.02)
"""About the body's axes, kg m^2."""
TORQUES = (0.1, 0.1, 0.05)
"""Bounds about the body's axes, N m."""
FAR, TILT = 2.0, math.pi / 3
"""It crashes beyond these, m in each direction, and rad of roll or pitch."""


class Quadrotor(RowSim):
    """A rigid body of 1 kg with a thrust along its axis and three torques.

    ======== ==================================================================================
    state    position x, y, z (m, z up), velocity vx, vy, vz (m/s), roll, pitch, yaw (rad), and the
             rates p, q, r about the body's axes (rad/s)
    action   thrust (N, 0 to ``most_thrust`` times the weight), torques about the body's axes (N m)
    start    positions uniform within 0.1 m of the origin, everything else within 0.05
    end      crash beyond 2 m in a direction, or 60 degrees of roll or pitch
    ======== ==================================================================================
    """

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

    def rows(self, xp: Namespace) -> Rows:
        """Two steps of Runge and Kutta's method; constants: dt."""

        def started(i: int) -> Function:
            size = 0.1 if i < 3 else 0.05
            return xp.jit(lambda s, u, c: (size * (2 * u[i] - 1),))

        move = runge_kutta_over(xp, derivative_over(xp), 12, 2)

        def outcome(s, c):
            near = xp.both(xp.abs(s[0]) <= FAR, xp.abs(s[1]) <= FAR)
            level = xp.both(xp.abs(s[6]) <= TILT, xp.abs(s[7]) <= TILT)
            near = xp.both(near, xp.abs(s[2]) <= FAR)
            return xp.where(xp.both(near, level), RUNNING, FAILED)

        return Rows(
            width=12,
            step=lambda s, action, uniforms, c: move(s, action, c[0]),
            observe=lambda s, c: s,
            outcome=outcome,
            start=joined(xp, *(started(i) for i in range(12))),
            constants=(float(self.spec.dt),),
        )

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """None."""
        return {}


def derivative_over(xp: Namespace) -> Function:
    """ds/dt from state and action: Newton's and Euler's equations, roll-pitch-yaw angles."""
    i_x, i_y, i_z = INERTIA

    @xp.jit
    def derivative(state, action):
        _, _, _, vx, vy, vz, roll, pitch, yaw, p, q, r = state
        thrust, about_x, about_y, about_z = action
        sr, cr, sp, cp = xp.sin(roll), xp.cos(roll), xp.sin(pitch), xp.cos(pitch)
        sy, cy = xp.sin(yaw), xp.cos(yaw)
        turning = q * sr + r * cr
        return (
            *(vx, vy, vz),
            (cy * sp * cr + sy * sr) * thrust,
            (sy * sp * cr - cy * sr) * thrust,
            cp * cr * thrust - GRAVITY,
            *(p + turning * xp.tan(pitch), q * cr - r * sr, turning / cp),
            (about_x - (q * (i_z * r) - r * (i_y * q))) / i_x,
            (about_y - (r * (i_x * p) - p * (i_z * r))) / i_y,
            (about_z - (p * (i_y * q) - q * (i_x * p))) / i_z,
        )

    return derivative
