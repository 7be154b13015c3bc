"""A pole on a cart, to be swung up from hanging and held at a place."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.cart_pole import derivative_over
from sims.tasks.held_tip import HeldTip

LENGTH = 0.5
"""m."""


class CartPoleSwingUp(HeldTip):
    """The cart-pole swing-up of Deisenroth & Rasmussen ("PILCO", ICML 2011).

    ======== ==================================================================================
    state    position (m) and speed (m/s) of the cart, angle of the pole from upright (rad, positive
             anticlockwise) and its rate (rad/s)
    action   force on the cart (N), within 10 N either way
    start    hanging at position 0, at rest; normal, standard deviation 0.1 of each component
    success  tip within ``width`` of (reference, 0.5 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    Equations and constants: those of ``sims.tasks.cart_pole``, which are those of pilco-matlab,
    ``scenarios/cartPole`` (``dynamics_cp.m``, ``settings_cp.m``).  Reference of the tip, t seconds
    after the start: ``amplitude`` sin(2 pi t / ``period``), m.
    """

    name = "cart_pole_swing_up"
    state = (
        Quantity("position", "m"),
        Quantity("speed", "m/s", scale=3.0, rate_of="position"),
        Quantity("angle", "rad", period=2 * math.pi),
        Quantity("rate", "rad/s", scale=6.0, rate_of="angle"),
    )
    action = (Quantity("force", "N", scale=10.0, low=-10.0, high=10.0),)
    mean = (0.0, 0.0, math.pi, 0.0)
    deviation = (0.1, 0.1, 0.1, 0.1)
    height = LENGTH
    substeps = 20

    def __init__(
        self,
        dt: float = 0.1,
        time_limit: float = 4.0,
        hold_from: float = 3.0,
        width: float = 0.25,
        amplitude: float = 0.0,
        period: float = 4.0,
    ) -> None:
        super().__init__(dt, time_limit, hold_from, width, amplitude, period)

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action."""
        of_force = derivative_over(xp)
        return lambda s, action: of_force(s, action[0])

    def joints(self, xp: Namespace) -> Function:
        """The pivot on the cart and the tip."""
        return lambda s: (s[0], 0.0, s[0] - LENGTH * xp.sin(s[2]), LENGTH * xp.cos(s[2]))
