"""Two uniform rods, one at the end of the other, on a fixed pivot."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace, Row
from sims.tasks.held_tip import HeldTip

MASS, LENGTH, GRAVITY = 0.5, 0.5, 9.82
"""kg and m of each rod, m/s^2."""


class TwoRods(HeldTip):
    """Rods of 0.5 kg and 0.5 m without friction, hanging at rest at the start; their tip is to be
    held upright.

    A subclass has ``name``, ``action``, ``substeps`` and ``derivative``.
    """

    state = (
        Quantity("angle_1", "rad", period=2 * math.pi),
        Quantity("rate_1", "rad/s", scale=6.0, rate_of="angle_1"),
        Quantity("angle_2", "rad", period=2 * math.pi),
        Quantity("rate_2", "rad/s", scale=6.0, rate_of="angle_2"),
    )
    mean = (math.pi, 0.0, math.pi, 0.0)
    deviation = (0.01, 0.1, 0.01, 0.1)
    height = 2 * LENGTH

    def joints(self, xp: Namespace) -> Function:
        """The pivot, the joint between the rods, the tip."""

        def joints(s: tuple[Row, ...]) -> tuple[Row, ...]:
            x, y = -LENGTH * xp.sin(s[0]), LENGTH * xp.cos(s[0])
            return 0.0, 0.0, x, y, x - LENGTH * xp.sin(s[2]), y + LENGTH * xp.cos(s[2])

        return joints


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
