"""The bicycle of Randløv and Alstrøm (1998): its equations of motion as a pure function.

J. Randløv and P. Alstrøm, "Learning to drive a bicycle using reinforcement learning and shaping",
ICML 1998, as their published C program has it (gravity of Copenhagen, signs and order of updates
included): angles in radians, positive to the left, that is, counter-clockwise seen from above.

Component order of a state (``STATE``): theta, theta_dot (the handlebar's angle and rate), omega,
omega_dot, omega_ddot (the frame's lean from the vertical, its rate, and its acceleration in the
step just made: only to be looked at, a step does not need it), psi (the frame's heading, 0 along
+y; the unit vector from back to front is (-sin psi, cos psi)), xf, yf, xb, yb (where the front and
the back tyre touch the ground, in m).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

from torch import Tensor

from sims.angles import atan2_over
from sims.rows import TORCH, Function, Namespace, NoRows, stacked, unstacked

Scalar = float | Tensor
"""A number, or a tensor ``[*batch]`` with one of its own for every element of the batch."""

STATE = ("theta", "theta_dot", "omega", "omega_dot", "omega_ddot", "psi", "xf", "yf", "xb", "yb")

WHEELBASE_TOLERANCE = 0.01
"""How far (m) the tyres' distance may be from the wheelbase before the back tyre is put right."""


@dataclass(frozen=True)
class Physics:
    """Constants of the bicycle, by the names of the article and its C program.

    Each may be a tensor ``[*batch]``: a bicycle of its own for every element of the batch.
    """

    v: Scalar = 10 / 3.6
    """Speed of either tyre along its path, m/s."""
    g: Scalar = 9.82
    """Gravity, m/s^2."""
    d_CM: Scalar = 0.30
    """Vertical distance between the centres of mass of bicycle and rider, m."""
    c: Scalar = 0.66
    """Horizontal distance between the front tyre's contact and the centre of mass, m."""
    h: Scalar = 0.94
    """Height of the centre of mass, m."""
    l: Scalar = 1.11  # noqa: E741 (the article's letter)
    """Wheelbase, m."""
    M_c: Scalar = 15.0
    """Mass of the bicycle, kg."""
    M_d: Scalar = 1.7
    """Mass of a tyre, kg."""
    M_p: Scalar = 60.0
    """Mass of the rider, kg."""
    r: Scalar = 0.34
    """Radius of a tyre, m."""
    theta_max: Scalar = 1.3963
    """The handlebar's stop (80 degrees, in the digits of the C program), rad."""
    omega_max: Scalar = math.pi / 15
    """The lean beyond which the bicycle has fallen (12 degrees), rad."""
    true_precession: bool = False
    """Whether the front wheel, falling to the left, turns to the left, as gyroscopes do; in the C
    program it turns to the right."""

    def __post_init__(self) -> None:
        """Refuse constants that are not above 0."""
        for constant in fields(self):
            value = getattr(self, constant.name)
            if isinstance(value, bool | Tensor):
                continue
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{constant.name}={value}: expected a finite number above 0")

    @property
    def M(self) -> Scalar:
        """Mass of bicycle and rider, kg."""
        return self.M_c + self.M_p

    @property
    def I_B(self) -> Scalar:
        """Moment of inertia of bicycle and rider about the line of the tyres, kg m^2."""
        return _inertia(self)

    @property
    def I_d(self) -> Scalar:
        """M_d r^2, kg m^2: a tyre's I_dc is 1, its I_dv 3/2, its I_dl 1/2 of it."""
        return self.M_d * self.r * self.r

    @property
    def sigma_dot(self) -> Scalar:
        """Angular velocity of a tyre, rad/s."""
        return self.v / self.r


RANDLOV = Physics()
"""The constants of the C program."""

Integrator = Callable[
    [Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, float, Scalar],
    tuple[Tensor, Tensor, Tensor, Tensor],
]
"""(theta, theta_dot, theta_ddot, omega, omega_dot, omega_ddot, dt, stop of the handlebar) to
(theta, theta_dot, omega, omega_dot) one step of dt seconds later."""


def _inertia(p: Any) -> Any:
    height = p.h + p.d_CM
    return 13 / 3 * p.M_c * p.h * p.h + p.M_p * height * height


def _semi_implicit_over(xp: Namespace) -> Function:
    @xp.jit
    def integrate(theta, theta_dot, theta_ddot, omega, omega_dot, omega_ddot, dt, stop):
        omega_dot = omega_dot + dt * omega_ddot
        theta_dot = theta_dot + dt * theta_ddot
        theta = xp.maximum(xp.minimum(theta + dt * theta_dot, stop), -stop)
        return theta, theta_dot, omega + dt * omega_dot, omega_dot

    return integrate


def _explicit_euler_over(xp: Namespace) -> Function:
    @xp.jit
    def integrate(theta, theta_dot, theta_ddot, omega, omega_dot, omega_ddot, dt, stop):
        turned = theta + dt * theta_dot
        theta_dot = xp.where(xp.abs(turned) > stop, 0.0, theta_dot + dt * theta_ddot)
        theta = xp.maximum(xp.minimum(turned, stop), -stop)
        return theta, theta_dot, omega + dt * omega_dot, omega_dot + dt * omega_ddot

    return integrate


_SEMI_IMPLICIT, _EXPLICIT_EULER = _semi_implicit_over(TORCH), _explicit_euler_over(TORCH)


def semi_implicit(*motion: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Rates first, then angles with the new rates, as in the C program: an ``Integrator``.

    The handlebar's angle is held at the stop; its rate is not, and winds up.
    """
    return _SEMI_IMPLICIT(*motion)


def explicit_euler(*motion: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Angles with the old rates; the handlebar comes to rest at its stop: an ``Integrator``.

    After D. Ernst, P. Geurts and L. Wehenkel, "Tree-based batch mode reinforcement learning",
    JMLR 6, 2005.
    """
    return _EXPLICIT_EULER(*motion)


def integrator_over(xp: Namespace, integrate: Integrator) -> Function:
    """``integrate`` over rows; in torch any one, else NoRows for one that is not of this module."""
    if xp is TORCH:
        return integrate
    chosen: Any = integrate.func if isinstance(integrate, partial) else integrate
    known: dict[Any, Function] = {
        semi_implicit: _semi_implicit_over,
        explicit_euler: _explicit_euler_over,
    }
    if chosen not in known:
        raise NoRows(
            f"integrate={getattr(chosen, '__name__', chosen)}: over rows there are only"
            " semi_implicit and explicit_euler"
        )
    return known[chosen](xp)


def step(
    state: Tensor,
    action: Tensor,
    disturbance: Tensor,
    *,
    physics: Physics = RANDLOV,
    integrate: Integrator = semi_implicit,
    dt: float = 0.01,
    side_force: Tensor | None = None,
) -> Tensor:
    r"""The state ``[*batch, 10]`` of the bicycle ``dt`` seconds later.

    .. math::
        I_B \ddot\omega &= h M g \sin\varphi - \cos\varphi\,[I_{dc} \dot\sigma \dot\theta
          + \mathrm{sign}(\theta) v^2 (M_d r (k_f + k_b) + M h k_{CM}) - h F] \\
        I_{dl} \ddot\theta &= T - I_{dv} \dot\omega \dot\sigma

    with :math:`\varphi = \omega + \arctan((d + w) / h)` and the inverse radii
    :math:`k_f = |\sin\theta| / l`, :math:`k_b = |\tan\theta| / l`,
    :math:`k_{CM} = ((l - c)^2 + l^2 / \tan^2\theta)^{-1/2}` of the paths of the tyres and of the
    centre of mass.  Both gyroscopic terms carry a minus sign, as in the C program and all its
    ports, though the second should be a plus, for gyroscopes do no work: with it
    (``physics.true_precession``) the bicycle stands 2.96 s untouched instead of 1.69 s.

    :math:`F` is the wind.  The centre of mass lies h sin(phi) to the left of the line of the tyres
    and h cos(phi) above it, so that a level force to the left does the work F d(h sin(phi)) and has
    the moment F h cos(phi) about that line, a plus: it throws the bicycle to the left.  The tyres
    do not slip, and it has no moment about the steering axis.

    Arguments: ``state`` ``[*batch, 10]`` (order ``STATE``, abs(theta) below pi), ``action``
    ``[*batch, 2]`` (torque T on the handlebar in N m, displacement d of the rider in m: taken as
    they are, without clipping), ``disturbance`` ``[*batch]`` (w, added to d, in m), ``side_force``
    ``[*batch]`` (F, level and at right angles to the frame's direction, in N, positive to the left;
    None for no wind).  Nothing ends here: a bicycle that lies flat goes on turning about its tyres.

    Float64 is meant; in float32 it runs, but a position a kilometre away is good to 0.1 mm only,
    too coarse for headings.  On the CPU an element of a batch comes out with the same digits as
    alone.
    """
    move = step_over(TORCH, integrate, physics.true_precession, side_force is not None)
    torque, displacement = unstacked(action)
    moved = move(unstacked(state), torque, displacement + disturbance, side_force, physics, dt)
    return stacked(moved, state)


def step_over(xp: Namespace, integrate: Integrator, true_precession: bool, windy: bool) -> Function:
    """``step`` over rows: a function of the state, torque, displacement with its disturbance, side
    force (not looked at unless ``windy``), constants by the names of ``Physics``, and dt.  Raises
    NoRows (``integrator_over``)."""
    integrated = integrator_over(xp, integrate)
    inertia_of, (_, atan2) = xp.jit(_inertia), atan2_over(xp)
    precession_sign = 1.0 if true_precession else -1.0

    @xp.jit
    def step(state, torque, displacement, side_force, p, dt):
        theta, theta_dot, omega, omega_dot, psi = state[0], state[1], state[2], state[3], state[5]
        # With their signs, sin and tan need neither sign(theta) nor abs and have a derivative at
        # 0.
        sine = xp.sin(theta)
        tangent = sine / xp.abs(xp.cos(theta))
        behind = p.l - p.c
        centre = tangent / xp.sqrt(tangent * tangent * (behind * behind) + p.l * p.l)
        inertia, mass, spin, I_d = inertia_of(p), p.M_c + p.M_p, p.v / p.r, p.M_d * p.r * p.r
        centrifugal = (sine + tangent) * (p.v * p.v * p.M_d * p.r / (p.l * inertia)) + centre * (
            p.v * p.v * mass * p.h / inertia
        )
        level = theta_dot * (I_d * spin / inertia) + centrifugal
        if windy:
            level = level - side_force * (p.h / inertia)
        phi = omega + xp.atan(displacement / p.h)
        omega_ddot = xp.sin(phi) * (p.h * mass * p.g / inertia) - xp.cos(phi) * level
        precession = omega_dot * (3 * spin)  # I_dv / I_dl = 3
        theta_ddot = torque / (0.5 * I_d) + precession_sign * precession
        theta, theta_dot, omega, omega_dot = integrated(
            theta, theta_dot, theta_ddot, omega, omega_dot, omega_ddot, dt, p.theta_max
        )

        # The tyres: new handlebar, old radii and heading.  The half-chord angle takes the sign of
        # the direction rather than of the handlebar: so does the C program.  All directions are
        # turned about here (positive to the right): (sin, cos) is the way east and north.
        way, half = p.v * dt, p.v * dt / (2 * p.l)
        front, back = -(psi + theta), -psi
        front = front + xp.sign(front) * xp.asin(xp.minimum(xp.abs(sine * half), 1.0))
        back = back + xp.sign(back) * xp.asin(xp.minimum(xp.abs(tangent * half), 1.0))
        xf, yf = state[6] + xp.sin(front) * way, state[7] + xp.cos(front) * way
        xb, yb = state[8] + xp.sin(back) * way, state[9] + xp.cos(back) * way

        # The tyres drift apart: put the back tyre right.  That leaves the heading as it is.
        dx, dy = xf - xb, yf - yb
        distance = xp.sqrt(dx * dx + dy * dy)
        gap = p.l - distance
        share = xp.where(xp.abs(gap) <= WHEELBASE_TOLERANCE, 0.0, gap) / distance
        psi = atan2(-dx, dy, distance)
        xb, yb = xb - dx * share, yb - dy * share
        return theta, theta_dot, omega, omega_dot, omega_ddot, psi, xf, yf, xb, yb

    return step
