"""A pendulum between two stops, to be swung up from hanging and held."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.events import events_over
from sims.tasks.held_tip import HeldTip
from sims.tasks.integrate import runge_kutta_over
from sims.tasks.pendulum_swing_up import LENGTH, derivative_over, joints_over

LOW, HIGH = -0.5, math.pi + 0.4
"""The stops, rad from upright: shortly beyond upright, and beyond hanging on the other side."""


class StopPendulum(HeldTip):
    """The rod of ``sims.tasks.pendulum_swing_up`` with a stronger motor, between two inelastic
    stops: a task of our own.  Neither a full turn nor a wide swing leads to upright.

    ======== ==================================================================================
    state    angle from upright (rad, positive anticlockwise), within -0.5 and pi + 0.4, and its
             rate (rad/s)
    action   torque (N m), within 3 N m either way: 0.6 of gravity's greatest
    start    hanging at rest; normal, standard deviation 0.1 of each component
    stops    a rod that hits one is at rest; it stays there as long as the torque, gravity's
             included, presses it on
    success  tip within ``width`` of (0, 1 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    An angle is read within half a turn of upright: the upper stop as pi + 0.4 - 2 pi.
    """

    name = "stop_pendulum"
    state = (
        Quantity("angle", "rad", period=2 * math.pi),
        Quantity("rate", "rad/s", scale=6.0, rate_of="angle"),
    )
    action = (Quantity("torque", "N m", scale=3.0, low=-3.0, high=3.0),)
    mean = (math.pi, 0.0)
    deviation = (0.1, 0.1)
    height = LENGTH
    substeps = 5
    walls = (LOW, HIGH)

    def __init__(
        self,
        dt: float = 0.05,
        time_limit: float = 4.0,
        hold_from: float = 3.0,
        width: float = 0.25,
    ) -> None:
        super().__init__(dt, time_limit, hold_from, width)

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action between the stops."""
        return derivative_over(xp)

    def motion(self, xp: Namespace) -> Function:
        """The state after ``dt`` seconds, with one hit at most: the rod is at rest after it."""
        free = xp.jit(derivative_over(xp))

        @xp.jit
        def derivative(s, given):
            # given: torque, whether the rod is at the lower and at the upper stop.
            rate, rise = free(s, given)
            rise = xp.where(given[1] > 0.5, xp.maximum(rise, 0.0), rise)
            return rate, xp.where(given[2] > 0.5, xp.minimum(rise, 0.0), rise)

        step = runge_kutta_over(xp, derivative, 2, 1)

        @xp.jit
        def move(s, seconds):
            at_low = xp.as_number(xp.both(s[0] <= LOW, s[1] <= 0.0))
            at_high = xp.as_number(xp.both(s[0] >= HIGH, s[1] >= 0.0))
            angle, rate = step((s[0], s[1]), (s[2], at_low, at_high), seconds)
            return angle, rate, s[2]

        @xp.jit
        def gaps(s):
            return s[0] - LOW, s[1], HIGH - s[0], -s[1]

        @xp.jit
        def land(s, guard):
            hit = guard > -0.5
            angle = xp.where(hit, xp.where(guard > 0.5, HIGH, LOW), s[0])
            return angle, xp.where(hit, 0.0, s[1]), s[2]

        passed = events_over(
            xp, move, gaps, land, width=3, guards=2, substeps=self.substeps, events=1
        )

        @xp.jit
        def motion(s, action, dt):
            angle, rate, _ = passed((s[0], s[1], action[0]), dt)
            return angle, rate

        return motion

    def joints(self, xp: Namespace) -> Function:
        """The pivot and the tip."""
        return joints_over(xp)
