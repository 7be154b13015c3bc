"""What the bicycle's learners are measured against: the linear-quadratic regulator that knows it.

The step of the bicycle is linearised where it rides upright and straight, by automatic
differentiation, for the constants of each bicycle; Riccati's equation gives the gains.  It sees the
true state, and neither the wind nor the handlebar's stop, the bounds of its actions or the lean at
which it falls.  So it is no upper bound, but what linear control theory does with full knowledge.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor

from sims.base import Spec, spec_index
from sims.bicycle.life import Numbers
from sims.bicycle.physics import Integrator, Physics, step

REDUCED = ("handlebar", "handlebar_rate", "lean", "lean_rate", "heading")
"""Order of the state that is regulated, in rad and rad/s; heading: minus the angle to the goal."""

STATE_COST = (1.0, 0.0, 10.0, 0.0, 1.0)
"""Per rad^2 or (rad/s)^2 of ``REDUCED``: lean and angle to the goal as in the learners' reward."""

ACTION_COST = (0.25, 2500.0)
"""Per (N m)^2 and m^2: 1 for either action at its bound.  With a tenth of it the bounds are met so
often that 3 % of the starts off balance are lost, with a hundredth 7 %; with this one none are."""

HEADING_BOUND = 0.5
"""How much of the angle to the goal (rad) is asked for at once.  Of 200 rides in each of the harder
worlds none falls with it; with 1.0 up to 4 do, and with 0.25 some gates of a slalom are missed."""


class Ridden(Protocol):
    """What the regulator asks of a bicycle (``sims.bicycle.bicycle.Bicycle``)."""

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        ...

    @property
    def dt(self) -> float:
        """Seconds per step."""
        ...

    @property
    def integrate(self) -> Integrator:
        """The integrator of its steps."""
        ...

    def constants(self, state: Tensor, /) -> Physics:
        """The constants of each bicycle."""
        ...

    def observe(self, state: Tensor, /) -> Tensor:
        """What the rider sees."""
        ...

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor, /) -> Tensor:
        """The state one step later."""
        ...

    def upright(self, state: Tensor, /) -> Tensor:
        """Whether it has not fallen."""
        ...


def _numbers(physics: Physics) -> Tensor:
    """The constants as a tensor ``[*batch, 12]``."""
    numbers = (torch.as_tensor(getattr(physics, k), dtype=torch.float64) for k in Numbers._fields)
    return torch.stack(torch.broadcast_tensors(*numbers), dim=-1)


def linearised(physics: Physics, integrate: Integrator, dt: float) -> tuple[Tensor, Tensor]:
    """F ``[*batch, 5, 5]`` and G ``[*batch, 5, 2]`` of x' = F x + G a, upright and straight, where
    x is ``REDUCED``; batch: that of the constants of ``physics``."""
    constants = _numbers(physics)
    batch = constants.shape[:-1]

    def moved(x: Tensor, action: Tensor, constants: Tensor) -> Tensor:
        own = replace(physics, **dict(zip(Numbers._fields, constants.unbind(-1), strict=True)))
        theta, theta_dot, omega, omega_dot, psi = x.unbind(-1)
        zero = torch.zeros_like(psi)
        tyres = (-psi.sin() * own.l, psi.cos() * own.l, zero, zero)
        state = torch.stack((theta, theta_dot, omega, omega_dot, zero, psi, *tyres))
        new = step(state, action, zero, physics=own, integrate=integrate, dt=dt)
        return torch.cat((new[:4], new[5:6]))

    x = torch.zeros(5, dtype=torch.float64)
    action = torch.zeros(2, dtype=torch.float64)
    jacobian = torch.func.vmap(torch.func.jacrev(moved, (0, 1)), (None, None, 0))
    F, G = jacobian(x, action, constants.reshape(-1, len(Numbers._fields)))
    return F.reshape(*batch, 5, 5), G.reshape(*batch, 5, 2)


def regulator(F: Tensor, G: Tensor, state_cost: Tensor, action_cost: Tensor) -> Tensor:
    """Gains ``[*batch, m, n]`` of a = K x that minimise the sum of x'Q x + a'R a over an endless
    ride, Q and R being the costs ``[n]`` and ``[m]`` as diagonals.

    Riccati's equation by doubling the horizon: B. D. O. Anderson, "Second-order convergent
    algorithms for the steady-state Riccati equation", 1978.  ValueError if there is no solution.
    """
    Q, R = torch.diag(state_cost).expand(F.shape), torch.diag(action_cost)
    A, P = F, Q
    W = G @ torch.linalg.solve(R, G.mT)
    eye = torch.eye(F.shape[-1], dtype=F.dtype)
    for _ in range(60):
        inverse = torch.linalg.inv(eye + W @ P)
        more = A.mT @ P @ inverse @ A
        W = W + A @ inverse @ W @ A.mT
        A = A @ inverse @ A
        P = P + 0.5 * (more + more.mT)
        if not bool(P.isfinite().all()):
            break
        if bool((more.abs().amax((-1, -2)) <= 1e-12 * P.abs().amax((-1, -2))).all()):
            pull = G.mT @ P
            return -torch.linalg.solve(R + pull @ G, pull @ F)
    raise ValueError("this bicycle cannot be held upright by its linear regulator")


class BicycleLqr:
    """The regulator as a controller: full states of ``bicycle`` ``[*batch, k]`` to actions
    ``[*batch, 2]`` in N m and m, not clipped.

    Each bicycle gets the gains of its own constants.  They are remembered from one call to the
    next, since finding them takes longer than a ride's step.
    """

    def __init__(self, bicycle: Ridden) -> None:
        self._bicycle = bicycle
        self._constants: Tensor | None = None
        self._gains = torch.empty(0)

    def gains(self, state: Tensor) -> Tensor:
        """``[*batch, 2, 5]`` (or ``[2, 5]`` where all have the same), for ``REDUCED``."""
        physics = self._bicycle.constants(state)
        constants = _numbers(physics)
        if self._constants is None or not torch.equal(constants, self._constants):
            F, G = linearised(physics, self._bicycle.integrate, self._bicycle.dt)
            costs = (torch.tensor(cost, dtype=torch.float64) for cost in (STATE_COST, ACTION_COST))
            self._gains, self._constants = regulator(F, G, *costs), constants
        return self._gains

    def __call__(self, state: Tensor) -> Tensor:
        """The actions."""
        seen = self._bicycle.observe(state)
        names = (*REDUCED[:4], "angle_to_goal")
        x = seen[..., spec_index(self._bicycle.spec, names)]
        heading = -x[..., 4:].clamp(-HEADING_BOUND, HEADING_BOUND)
        x = torch.cat((x[..., :4], heading), dim=-1)
        return (self.gains(state) @ x.unsqueeze(-1)).squeeze(-1)


def saved(bicycle: Ridden, start: Tensor, uniforms: Tensor | None = None) -> Tensor:
    """Which of the states ``start`` ``[*batch, k]`` the regulator can ride on from, bool
    ``[*batch]``: its actions held within their bounds, no fall in 5 s (the slowest motion of the
    upright bicycle takes about a second).

    uniforms: what disturbs the ride, ``[T, *batch, disturbance_dim]`` of at least 5 s; None for a
    ride without any.
    """
    control, spec = BicycleLqr(bicycle), bicycle.spec
    low = torch.tensor([q.low for q in spec.action], dtype=start.dtype)
    high = torch.tensor([q.high for q in spec.action], dtype=start.dtype)
    if uniforms is None:
        # At the middle of its range the disturbance is zero, and no gust begins.
        calm = (*start.shape[:-1], spec.disturbance_dim)
        uniforms = torch.full((1, *calm), 0.5, dtype=start.dtype).expand(_steps(bicycle), *calm)
    state, up = start, bicycle.upright(start)
    with torch.no_grad():
        for k in range(_steps(bicycle)):
            action = control(state).maximum(low).minimum(high)
            state = bicycle.step(state, action, uniforms[k])
            up = up & bicycle.upright(state)
    return up


def _steps(bicycle: Ridden) -> int:
    return round(5.0 / bicycle.dt)
