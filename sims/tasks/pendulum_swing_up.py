"""A pendulum whose motor is too weak to lift it, to be swung up from hanging and held."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.held_tip import HeldTip

MASS, LENGTH, FRICTION, GRAVITY = 1.0, 1.0, 0.01, 9.82
"""kg, m, N m s/rad, m/s^2."""


class PendulumSwingUp(HeldTip):
    """The pendulum of M. P. Deisenroth, "Efficient Reinforcement Learning Using Gaussian
    Processes" (2010), appendix C: a uniform rod with a torque at its fixed end.

    ======== ==================================================================================
    state    angle from upright (rad, positive anticlockwise) and its rate (rad/s)
    action   torque (N m), within 2.5 N m either way: about half of gravity's greatest
    start    hanging at rest; normal, standard deviation 0.1 of each component
    success  tip within ``width`` of (0, 1 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================
    """

    name = "pendulum_swing_up"
    state = (
        Quantity("angle", "rad", period=2 * math.pi),
        Quantity("rate", "rad/s", scale=6.0, rate_of="angle"),
    )
    action = (Quantity("torque", "N m", scale=2.5, low=-2.5, high=2.5),)
    mean = (math.pi, 0.0)
    deviation = (0.1, 0.1)
    height = LENGTH
    substeps = 10

    def __init__(
        self,
        dt: float = 0.1,
        time_limit: float = 4.0,
        hold_from: float = 3.0,
        width: float = 0.5,
    ) -> None:
        super().__init__(dt, time_limit, hold_from, width)

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action."""
        return derivative_over(xp)

    def joints(self, xp: Namespace) -> Function:
        """The pivot and the tip."""
        return joints_over(xp)


def derivative_over(xp: Namespace) -> Function:
    """ds/dt from state and action: m l^2 / 3 times the acceleration is the torque."""

    def derivative(s, action):
        angle, rate = s
        lever = MASS * GRAVITY * LENGTH / 2
        torque = action[0] + lever * xp.sin(angle) - FRICTION * rate
        return rate, torque / (MASS * LENGTH**2 / 3)

    return derivative


def joints_over(xp: Namespace) -> Function:
    """The pivot and the tip, (x, y, x, y) in m."""
    return lambda s: (0.0, 0.0, -LENGTH * xp.sin(s[0]), LENGTH * xp.cos(s[0]))
