"""A pole on a cart, held upright at a position, with a constant force on the cart."""

from __future__ import annotations

import torch
from torch import Tensor

from sims.base import Outcome, Quantity, Spec, expect_action
from sims.tasks.integrate import runge_kutta

GRAVITY = 9.82
"""m/s^2."""
RAIL, LEAN = 2.4, 0.6
"""An episode fails beyond these, m and rad."""


class CartPole:
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

    traceable = True

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

    def initial(self, uniforms: Tensor) -> Tensor:
        """``[*batch, 4]``."""
        return 0.05 * (2 * uniforms - 1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """A new start where ``mask``."""
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """Two steps of Runge and Kutta's method."""
        expect_action(state, action, 1)
        force = action[..., 0] + self.push
        return runge_kutta(lambda s: _derivative(s, force), state, self.spec.dt, 2)

    def observe(self, state: Tensor) -> Tensor:
        """All of the state."""
        return state

    def outcome(self, state: Tensor) -> Tensor:
        """``FAILED`` beyond the rail or the lean."""
        within = (state[..., 0].abs() <= RAIL) & (state[..., 2].abs() <= LEAN)
        return torch.where(within, int(Outcome.RUNNING), int(Outcome.FAILED))

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """None."""
        return {}


def _derivative(state: Tensor, force: Tensor) -> Tensor:
    """ds/dt ``[*batch, 4]``; force ``[*batch]``, N."""
    cart, pole, length, friction = 0.5, 0.5, 0.5, 0.1
    _, speed, angle, rate = state.unbind(-1)
    sin, cos = angle.sin(), angle.cos()
    pull = force - friction * speed
    spin = pole * length * rate.square() * sin
    inertia = 4 * (cart + pole) - 3 * pole * cos.square()
    speed_rate = (-2 * spin + 3 * pole * GRAVITY * sin * cos + 4 * pull) / inertia
    rate_rate = (-3 * spin * cos + 6 * (cart + pole) * GRAVITY * sin + 6 * pull * cos) / (
        length * inertia
    )
    return torch.stack([speed, speed_rate, rate, rate_rate], dim=-1)
