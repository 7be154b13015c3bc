"""A double pendulum with a torque on its inner rod alone."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.double_pendulum import LENGTH, STATE, derivative_over, joints_over
from sims.tasks.held_tip import HeldTip


class Pendubot(HeldTip):
    """The pendubot of pilco-matlab, ``scenarios/pendubot`` (``dynamics_pendubot.m``,
    ``settings_pendubot.m``).

    ======== ==================================================================================
    state    angles of the inner and the outer rod, both from upright (rad, positive anticlockwise),
             and their rates (rad/s): ``angle_1``, ``rate_1``, ``angle_2``, ``rate_2``
    action   torque on the inner rod (N m), within 3.5 N m either way
    start    hanging at rest; normal, standard deviations 0.01 rad and 0.1 rad/s
    success  tip within ``width`` of (0, 1 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    The rods are those of ``sims.tasks.double_pendulum``.
    """

    substeps = 20

    def __init__(
        self,
        dt: float = 0.05,
        time_limit: float = 3.0,
        hold_from: float = 2.0,
        width: float = 0.25,
    ) -> None:
        super().__init__(
            name="pendubot",
            state=STATE,
            action=(Quantity("torque", "N m", scale=3.5, low=-3.5, high=3.5),),
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
        return lambda s, action: moved(s, action[0], 0.0)

    def joints(self, xp: Namespace) -> Function:
        """The pivot, the joint between the rods, the tip."""
        return joints_over(xp)
