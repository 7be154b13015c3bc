"""Two pendulums, one at the end of the other, with a torque on each."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace, Row
from sims.tasks.held_tip import HeldTip

MASS, LENGTH, GRAVITY = 0.5, 0.5, 9.82
"""kg and m of each rod, m/s^2."""

STATE = (
    Quantity("angle_1", "rad", period=2 * math.pi),
    Quantity("rate_1", "rad/s", scale=6.0, rate_of="angle_1"),
    Quantity("angle_2", "rad", period=2 * math.pi),
    Quantity("rate_2", "rad/s", scale=6.0, rate_of="angle_2"),
)


class DoublePendulum(HeldTip):
    """The double pendulum with two torques of pilco-matlab, ``scenarios/doublePendulum``
    (``dynamics_dp.m``, ``settings_dp.m``).

    ======== ==================================================================================
    state    angles of the inner and the outer rod, both from upright (rad, positive anticlockwise),
             and their rates (rad/s): ``angle_1``, ``rate_1``, ``angle_2``, ``rate_2``
    action   torques on the inner and on the outer rod (N m), within 2 N m either way
    start    hanging at rest; normal, standard deviations 0.01 rad and 0.1 rad/s
    success  tip within ``width`` of (0, 1 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    Uniform rods of 0.5 kg and 0.5 m without friction.  As published, the torque on the outer rod
    has no reaction on the inner one: the power of the actions is u_1 rate_1 + u_2 rate_2.
    """

    substeps = 40

    def __init__(
        self,
        dt: float = 0.1,
        time_limit: float = 3.0,
        hold_from: float = 2.0,
        width: float = 0.5,
    ) -> None:
        super().__init__(
            name="double_pendulum",
            state=STATE,
            action=tuple(
                Quantity(f"torque_{k}", "N m", scale=2.0, low=-2.0, high=2.0) for k in (1, 2)
            ),
            mean=(math.pi, 0.0, math.pi, 0.0),
            deviation=(0.01, 0.1, 0.01, 0.1),
            height=2 * LENGTH,
            width=width,
            dt=dt,
            time_limit=time_limit,
            hold_from=hold_from,
        )

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action."""
        moved = xp.jit(derivative_over(xp))
        return lambda s, action: moved(s, action[0], action[1])

    def joints(self, xp: Namespace) -> Function:
        """The pivot, the joint between the rods, the tip."""
        return joints_over(xp)


def derivative_over(xp: Namespace) -> Function:
    """ds/dt from the state and the torques on the inner and the outer rod, N m."""
    # Moments of inertia: of the inner rod about the pivot, with the outer rod's mass at its end; of
    # the outer one about its joint; and what couples them.
    inner, outer = (1 / 3 + 1) * MASS * LENGTH**2, MASS * LENGTH**2 / 3
    coupling, weight = MASS * LENGTH**2 / 2, MASS * GRAVITY * LENGTH / 2

    def derivative(s: tuple[Row, ...], torque_1: Row, torque_2: Row) -> tuple[Row, ...]:
        angle_1, rate_1, angle_2, rate_2 = s
        sin, cos = xp.sin(angle_1 - angle_2), coupling * xp.cos(angle_1 - angle_2)
        first = torque_1 + 3 * weight * xp.sin(angle_1) - coupling * sin * (rate_2 * rate_2)
        second = torque_2 + weight * xp.sin(angle_2) + coupling * sin * (rate_1 * rate_1)
        determinant = inner * outer - cos * cos
        return (
            *(rate_1, (outer * first - cos * second) / determinant),
            *(rate_2, (inner * second - cos * first) / determinant),
        )

    return derivative


def joints_over(xp: Namespace) -> Function:
    """The pivot, the joint between the rods and the tip, (x, y, x, y, x, y) in m."""

    def joints(s: tuple[Row, ...]) -> tuple[Row, ...]:
        x, y = -LENGTH * xp.sin(s[0]), LENGTH * xp.cos(s[0])
        return 0.0, 0.0, x, y, x - LENGTH * xp.sin(s[2]), y + LENGTH * xp.cos(s[2])

    return joints
