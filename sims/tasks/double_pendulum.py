"""Two pendulums, one at the end of the other, with a torque on each."""

from __future__ import annotations

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.two_rods import TwoRods, derivative_over


class DoublePendulum(TwoRods):
    """The double pendulum with two torques of pilco-matlab, ``scenarios/doublePendulum``
    (``dynamics_dp.m``, ``settings_dp.m``).

    ======== ==================================================================================
    state    angles of the inner and the outer rod, both from upright (rad, positive anticlockwise),
             and their rates (rad/s): ``angle_1``, ``rate_1``, ``angle_2``, ``rate_2``
    action   torques on the inner and on the outer rod (N m), within 2 N m either way
    start    hanging at rest; normal, standard deviations 0.01 rad and 0.1 rad/s
    success  tip within ``width`` of (0, 1 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    The rods are those of ``sims.tasks.two_rods``.  As published, the torque on the outer rod
    has no reaction on the inner one: the power of the actions is u_1 rate_1 + u_2 rate_2.
    """

    name = "double_pendulum"
    action = tuple(Quantity(f"torque_{k}", "N m", scale=2.0, low=-2.0, high=2.0) for k in (1, 2))
    substeps = 40

    def __init__(
        self,
        dt: float = 0.1,
        time_limit: float = 3.0,
        hold_from: float = 2.0,
        width: float = 0.5,
    ) -> None:
        super().__init__(dt, time_limit, hold_from, width)

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action."""
        moved = xp.jit(derivative_over(xp))
        return lambda s, action: moved(s, action[0], action[1])
