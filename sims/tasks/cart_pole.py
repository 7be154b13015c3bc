"""A pole on a cart, held upright at a position, with a constant force on the cart."""

from __future__ import annotations

from torch import Tensor

from sims.base import Outcome, Quantity, Spec
from sims.rows import Function, Namespace, Rows, RowSim
from sims.tasks.integrate import runge_kutta_over

RUNNING, FAILED = int(Outcome.RUNNING), int(Outcome.FAILED)

GRAVITY = 9.82
"""m/s^2."""
RAIL, LEAN = 2.4, 0.6
"""An episode fails beyond these, m and rad."""


class CartPole(RowSim):
    """The cart-pole of Deisenroth & Rasmussen ("PILCO", 2011) about upright.

    ======== ==================================================================================
    state    position (m) and speed (m/s) of the cart, angle of the pole from upright (rad, positive
             where it leans backwards) and its rate (rad/s)
    action   force on the cart (N), within 10 N either way
    start    each component uniform within 0.05 of zero
    end      failure beyond 2.4 m or 0.6 rad
    ======== ==================================================================================

    A cart of 0.5 kg with friction 0.1 N s/m, a uniform pole of 0.5 kg and 0.5 m; ``push``: a
    constant force on the cart (N) that is not observed.
    """

    def __init__(self, push: float = 0.0, dt: float = 0.02, time_limit: float = 20.0) -> None:
        if not dt > 0:
            raise ValueError(f"dt={dt}: expected a number > 0 (s)")
        self.push = push
        self.spec = Spec(
            name="cart_pole",
            state=(
                Quantity("position", "m", limit=RAIL),
                Quantity("speed", "m/s", rate_of="position"),
                Quantity("angle", "rad", limit=LEAN),
                Quantity("rate", "rad/s", rate_of="angle"),
            ),
            action=(Quantity("force", "N", scale=10.0, low=-10.0, high=10.0),),
            dt=dt,
            time_limit=time_limit,
            disturbance_dim=0,
            reset_dim=4,
            clip_action=True,
            headline="angle",
        )

    def rows(self, xp: Namespace) -> Rows:
        """Two steps of Runge and Kutta's method; constants: push, dt."""
        start = xp.jit(lambda uniform: 0.05 * (2 * uniform - 1))
        move = runge_kutta_over(xp, derivative_over(xp), 4, 2)

        def outcome(s, c):
            within = xp.both(xp.abs(s[0]) <= RAIL, xp.abs(s[2]) <= LEAN)
            return xp.where(within, RUNNING, FAILED)

        return Rows(
            width=4,
            step=lambda s, action, uniforms, c: move(s, action[0] + c[0], c[1]),
            observe=lambda s, c: s,
            outcome=outcome,
            start=lambda s, u, c: (start(u[0]), start(u[1]), start(u[2]), start(u[3])),
            constants=(float(self.push), float(self.spec.dt)),
        )

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """None."""
        return {}


def derivative_over(xp: Namespace) -> Function:
    """ds/dt from the state and the force, N."""
    cart, pole, length, friction = 0.5, 0.5, 0.5, 0.1

    @xp.jit
    def derivative(state, force):
        _, speed, angle, rate = state
        sin, cos = xp.sin(angle), xp.cos(angle)
        pull = force - friction * speed
        spin = pole * length * (rate * rate) * sin
        inertia = 4 * (cart + pole) - 3 * pole * (cos * cos)
        speed_rate = (-2 * spin + 3 * pole * GRAVITY * sin * cos + 4 * pull) / inertia
        rate_rate = (-3 * spin * cos + 6 * (cart + pole) * GRAVITY * sin + 6 * pull * cos) / (
            length * inertia
        )
        return speed, speed_rate, rate, rate_rate

    return derivative
