"""A double pendulum with a torque on its inner rod alone."""

from __future__ import annotations

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.two_rods import TwoRods, derivative_over


class Pendubot(TwoRods):
    """The pendubot of pilco-matlab, ``scenarios/pendubot`` (``dynamics_pendubot.m``,
    ``settings_pendubot.m``).

    ======== ==================================================================================
    state    angles of the inner and the outer rod, both from upright (rad, positive anticlockwise),
             and their rates (rad/s): ``angle_1``, ``rate_1``, ``angle_2``, ``rate_2``
    action   torque on the inner rod (N m), within 3.5 N m either way
    start    hanging at rest; normal, standard deviations 0.01 rad and 0.1 rad/s
    success  tip within ``width`` of (0, 1 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    The rods are those of ``sims.tasks.two_rods``.
    """

    name = "pendubot"
    action = (Quantity("torque", "N m", scale=3.5, low=-3.5, high=3.5),)
    substeps = 20

    def __init__(
        self,
        dt: float = 0.05,
        time_limit: float = 3.0,
        hold_from: float = 2.0,
        width: float = 0.25,
    ) -> None:
        super().__init__(dt, time_limit, hold_from, width)

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action."""
        moved = xp.jit(derivative_over(xp))
        return lambda s, action: moved(s, action[0], 0.0)
