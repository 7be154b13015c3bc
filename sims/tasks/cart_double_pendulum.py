"""Two rods, one at the end of the other, on a cart: to be swung up from hanging."""

from __future__ import annotations

import math

from sims.base import Quantity
from sims.rows import Function, Namespace
from sims.tasks.held_tip import HeldTip

CART, MASS, LENGTH, FRICTION, GRAVITY = 0.5, 0.5, 0.6, 0.1, 9.82
"""kg, kg and m of each rod, N s/m of the cart, m/s^2."""


class CartDoublePendulum(HeldTip):
    """The cart-double-pendulum of pilco-matlab, ``scenarios/cartDoublePendulum``
    (``dynamics_cdp.m``, ``settings_cdp.m``).

    ======== ==================================================================================
    state    position (m) and speed (m/s) of the cart; angles of the inner and the outer rod, both
             from upright (rad, positive anticlockwise), and their rates (rad/s): ``position``,
             ``speed``, ``angle_1``, ``rate_1``, ``angle_2``, ``rate_2``
    action   force on the cart (N), within 20 N either way
    start    hanging at position 0, at rest; normal, standard deviations 0.01 rad, else 0.1
    success  tip within ``width`` of (0, 1.2 m) at all ticks from ``hold_from`` on
    ======== ==================================================================================

    (The published loss takes the rods for 1 m long, the published dynamics for 0.6 m.)
    """

    name = "cart_double_pendulum"
    state = (
        Quantity("position", "m"),
        Quantity("speed", "m/s", scale=3.0, rate_of="position"),
        Quantity("angle_1", "rad", period=2 * math.pi),
        Quantity("rate_1", "rad/s", scale=6.0, rate_of="angle_1"),
        Quantity("angle_2", "rad", period=2 * math.pi),
        Quantity("rate_2", "rad/s", scale=6.0, rate_of="angle_2"),
    )
    action = (Quantity("force", "N", scale=20.0, low=-20.0, high=20.0),)
    mean = (0.0, 0.0, math.pi, 0.0, math.pi, 0.0)
    deviation = (0.1, 0.1, 0.01, 0.1, 0.01, 0.1)
    height = 2 * LENGTH
    substeps = 20

    def __init__(
        self,
        dt: float = 0.05,
        time_limit: float = 5.0,
        hold_from: float = 4.0,
        width: float = 0.5,
    ) -> None:
        super().__init__(dt, time_limit, hold_from, width)

    def derivative(self, xp: Namespace) -> Function:
        """ds/dt from state and action: M(q) a = h by elimination of the outer rod, then of the
        inner one."""
        total, lever = CART + 2 * MASS, MASS * LENGTH / 2
        inner, outer = (1 / 3 + 1) * MASS * LENGTH**2, MASS * LENGTH**2 / 3
        coupling = MASS * LENGTH**2 / 2

        def derivative(s, action):
            _, speed, angle_1, rate_1, angle_2, rate_2 = s
            sin_1, sin_2, sin = xp.sin(angle_1), xp.sin(angle_2), xp.sin(angle_1 - angle_2)
            # The entries of M beside its diagonal (total, inner, outer).
            xa, xb = -3 * lever * xp.cos(angle_1), -lever * xp.cos(angle_2)
            ab = coupling * xp.cos(angle_1 - angle_2)
            spin_1, spin_2 = rate_1 * rate_1, rate_2 * rate_2
            hx = action[0] - FRICTION * speed - lever * (3 * spin_1 * sin_1 + spin_2 * sin_2)
            ha = 3 * lever * GRAVITY * sin_1 - coupling * spin_2 * sin
            hb = lever * GRAVITY * sin_2 + coupling * spin_1 * sin
            mxx, mxa, maa = total - xb * xb / outer, xa - xb * ab / outer, inner - ab * ab / outer
            hx, ha = hx - xb * hb / outer, ha - ab * hb / outer
            of_speed = (hx - mxa * ha / maa) / (mxx - mxa * mxa / maa)
            of_1 = (ha - mxa * of_speed) / maa
            return speed, of_speed, rate_1, of_1, rate_2, (hb - xb * of_speed - ab * of_1) / outer

        return derivative

    def joints(self, xp: Namespace) -> Function:
        """The pivot on the cart, the joint between the rods, the tip."""

        def joints(s):
            x, y = s[0] - LENGTH * xp.sin(s[2]), LENGTH * xp.cos(s[2])
            return s[0], 0.0, x, y, x - LENGTH * xp.sin(s[4]), y + LENGTH * xp.cos(s[4])

        return joints
