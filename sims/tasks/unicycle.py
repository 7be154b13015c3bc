"""A robotic unicycle, to be kept upright by torques on its wheel and on a disc above."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np
import torch
from torch import Tensor

from sims.base import Measure, Outcome, Quantity, Spec, Words, spec_index
from sims.rows import Function, Namespace, Rows, RowSim, first_over
from sims.tasks.episode import is_before, normal_start_over, readings_over
from sims.tasks.integrate import runge_kutta_over

_RUNNING, _FAILED, _SUCCEEDED = map(int, (Outcome.RUNNING, Outcome.FAILED, Outcome.SUCCEEDED))

FALLEN = math.pi / 2
"""rad of roll or pitch beyond which an episode fails."""

GRAVITY = 9.82
"""m/s^2."""
WHEEL, FRAME, DISC = 1.0, 23.5, 10.0
"""Masses, kg."""
RADIUS, TO_FRAME, TO_DISC = 0.225, 0.54, 0.81
"""m: of the wheel; from its centre to the centres of mass of frame and disc."""
WHEEL_SPIN, WHEEL_TURN = 0.0484, 0.0242
"""Moments of inertia of the wheel about its axle and across it, kg m^2."""
FRAME_X, FRAME_Y, FRAME_Z = 0.4608, 0.8292, 0.4248
"""Of the frame about its centre: forward, along the axle, along the pole."""
DISC_SPIN, DISC_TURN = 0.2, 1.3
"""Of the disc about the pole and across it."""

Constants = namedtuple("Constants", ("dt", "time_limit"))
"""The constants of ``Unicycle.rows``."""


class Unicycle(RowSim):
    """The robotic unicycle of pilco-matlab, ``scenarios/unicycle`` (``dynamics_unicycle.m``,
    ``settings_unicycle.m``): a wheel that rolls without slipping, a frame on its axle, and a disc
    on top of the frame that turns about the frame's pole.

    ======== ==================================================================================
    state    angles (rad) and, after each, its rate (rad/s): ``roll`` (positive to the left),
             ``yaw`` (anticlockwise from above), ``wheel`` and ``pitch`` (positive forward, against
             the plane of the wheel), ``disc`` (anticlockwise against the frame)
    action   torques of the frame on the disc, within 10 N m, and on the wheel, within 50 N m
    start    upright at rest at the origin; normal, standard deviation 0.02 of each angle and rate,
             0.1 m of each coordinate
    end      failure beyond pi/2 of roll or pitch, where all motion stops; success at the time limit
    ======== ==================================================================================

    A full state is that, followed by the place of the contact on the ground (m), the tick, and the
    greatest size of roll or pitch at a tick so far.  The place is not observed: nothing depends on
    it.

    Equations: ``derivative_over``.  Those of the pitch in the published file have the wheel's
    moment of inertia about the axle in place of the frame's, and so do not conserve energy.
    """

    substeps = 15

    def __init__(self, dt: float = 0.15, time_limit: float = 10.0) -> None:
        if not (math.isfinite(dt) and dt > 0):
            raise ValueError(f"dt={dt}: expected a finite number above 0 (s)")
        if not dt <= time_limit < math.inf:
            raise ValueError(f"time_limit={time_limit}: expected at least dt={dt} (s)")
        self.constants = Constants(float(dt), float(time_limit))
        names = ("roll", "yaw", "wheel", "pitch", "disc")
        limits = {"roll": FALLEN, "pitch": FALLEN}
        angles = [
            Quantity(name, "rad", period=2 * math.pi, limit=limits.get(name, math.inf))
            for name in names
        ]
        rates = [Quantity(f"{name}_rate", "rad/s", scale=6.0, rate_of=name) for name in names]
        self.spec = Spec(
            name="unicycle",
            state=tuple(q for pair in zip(angles, rates, strict=True) for q in pair),
            action=(
                Quantity("disc_torque", "N m", scale=10.0, low=-10.0, high=10.0),
                Quantity("wheel_torque", "N m", scale=50.0, low=-50.0, high=50.0),
            ),
            dt=dt,
            time_limit=time_limit,
            disturbance_dim=0,
            reset_dim=12,
            clip_action=True,
            headline="roll",
            measures=(
                Measure("largest_tilt_rad", "largest roll or pitch", "rad", "lower"),
                Measure("distance_m", "distance from the start", "m"),
            ),
            words=Words("fall", "falls", "ride", "rides", "fell", "rode"),
            survival=True,
            can_fail=True,
        )

    def rows(self, xp: Namespace) -> Rows:
        """Steps of Runge and Kutta's method; a fallen unicycle lies still."""
        inner, before = first_over(xp, 12), xp.jit(is_before)
        move = runge_kutta_over(xp, _stopped_over(xp), 12, self.substeps)
        start = normal_start_over(xp, (0.0,) * 12, (0.02,) * 10 + (0.1, 0.1))

        def step(s, action, uniforms, c):
            moved = move(inner(s), action, c.dt)
            tilt = xp.maximum(xp.abs(moved[0]), xp.abs(moved[6]))
            return (*moved, s[12] + 1, xp.maximum(s[13], tilt))

        def outcome(s, c):
            up = xp.both(xp.abs(s[0]) <= FALLEN, xp.abs(s[6]) <= FALLEN)
            running = xp.where(before(s[12], c.time_limit, c.dt), _RUNNING, _SUCCEEDED)
            return xp.where(up, running, _FAILED)

        def born(s, u, c):
            new = start(s, u, c)
            return (*new, 0.0, xp.maximum(xp.abs(new[0]), xp.abs(new[6])))

        return Rows(
            width=14,
            step=step,
            observe=readings_over(xp, self.spec.state),
            outcome=outcome,
            start=born,
            constants=self.constants,
        )

    def judge(self, states: Tensor) -> Tensor:
        """Whether episodes with these true states ``[*batch, T + 1, 10]``, one per tick from the
        start on, are successes, bool ``[*batch]``: upright at all ticks up to ``time_limit``, and
        no shorter."""
        c, ticks = self.constants, torch.arange(states.shape[-2]).to(states)
        tilts = states[..., spec_index(self.spec, ("roll", "pitch"))]
        up = (tilts.abs() <= FALLEN).all(-1)
        ended = ~is_before(ticks, c.time_limit, c.dt)
        after = ~is_before(ticks - 1, c.time_limit, c.dt)
        return (up | after).all(-1) & ended.any()

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished episodes, each ``[*batch]``.

        largest_tilt_rad: the greatest size of roll or pitch at a tick; distance_m: of the contact
        from where it was at the start.
        """
        return {
            "largest_tilt_rad": final[..., 13],
            "distance_m": (final[..., 10:12] - start[..., 10:12]).norm(dim=-1),
        }

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[270, 480, 3]``) of wheel, pole and disc and the path of the contact
        on the ground, for the states ``[T, k]`` of one episode so far."""
        from sims.tasks.picture import wires

        states = trail.detach().double().numpy()
        path = np.concatenate([states[:, 10:12], np.zeros((len(states), 1))], 1)
        roll, yaw, wheel, pitch, disc = states[-1, 0:10:2]
        # The axes of the plane of the wheel: forward, along the axle to the left, up.
        x = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        left, above = np.array([-x[1], x[0], 0.0]), np.array([0.0, 0.0, 1.0])
        y = math.cos(roll) * left - math.sin(roll) * above
        z = math.sin(roll) * left + math.cos(roll) * above
        forward = math.cos(pitch) * x - math.sin(pitch) * z
        pole = math.sin(pitch) * x + math.cos(pitch) * z
        hub = path[-1] + RADIUS * z
        top = hub + TO_DISC * pole

        def circle(centre: np.ndarray, a: np.ndarray, b: np.ndarray, turned: float) -> np.ndarray:
            """With a spoke that shows how far it has turned from a to b."""
            angles = turned + np.linspace(0, 2 * math.pi, 37)[:, None]
            rim = centre + RADIUS * (np.cos(angles) * a + np.sin(angles) * b)
            return np.concatenate([[centre], rim])

        return wires(
            [circle(hub, z, x, wheel), np.stack([hub, top]), circle(top, forward, y, disc)],
            ground=path[-1],
            path=path,
            seconds=float(states[-1, 12]) * self.constants.dt,
        )


def _stopped_over(xp: Namespace) -> Function:
    """ds/dt of the twelve components, zero beyond the end: PILCO's solver stops there, before roll
    and yaw become one."""
    moving = xp.jit(derivative_over(xp))

    @xp.jit
    def derivative(s, action):
        up = xp.both(xp.abs(s[0]) <= FALLEN, xp.abs(s[6]) <= FALLEN)
        a, b, c, d, e, f, g, h, i, j, k, m = moving(s, action)
        return (
            *(xp.where(up, a, 0.0), xp.where(up, b, 0.0), xp.where(up, c, 0.0)),
            *(xp.where(up, d, 0.0), xp.where(up, e, 0.0), xp.where(up, f, 0.0)),
            *(xp.where(up, g, 0.0), xp.where(up, h, 0.0), xp.where(up, i, 0.0)),
            *(xp.where(up, j, 0.0), xp.where(up, k, 0.0), xp.where(up, m, 0.0)),
        )

    return derivative


def derivative_over(xp: Namespace) -> Function:
    """d/dt of (roll, its rate, yaw, ..., disc, its rate, x, y) from that state and the torques on
    disc and wheel, N m.

    Kane's equations (T. R. Kane and D. A. Levinson, "Dynamics", 1985) in the generalized speeds

        roll    roll rate                     spin    wheel rate - yaw rate sin(roll)
        turn    yaw rate cos(roll)            lean    pitch rate - yaw rate sin(roll)

    and the disc's rate.  The plane of the wheel has the axes x forward, y along the axle, z up;
    those of the frame are turned from them by the pitch about y.  The angular velocities are

        plane (-roll, -k, turn), wheel (-roll, spin, turn), frame (-roll, lean, turn) in the plane
        (p, lean, q) of the frame in its own axes, with the disc's rate added to q for the disc

    with k = yaw rate sin(roll).  The contact is at rest, so the wheel's centre moves with
    RADIUS (spin, roll, 0), and a point at a height h of the pole with h (lean, -p, 0), in the axes
    of the frame, beside that.  (spin, lean) and (roll, turn) are not coupled by their
    accelerations, nor is the disc once its torque is given.
    """
    mass, moment = FRAME + DISC, FRAME * TO_FRAME + DISC * TO_DISC
    second = FRAME * TO_FRAME**2 + DISC * TO_DISC**2
    across, along = FRAME_X + DISC_TURN, FRAME_Y + DISC_TURN
    r, g = RADIUS, GRAVITY

    def derivative(s, action):
        theta, roll, yaw, yaw_rate, _, wheel_rate, phi, pitch_rate, _, disc_rate, _, _ = s
        on_disc, on_wheel = action
        st, ct, sf, cf = xp.sin(theta), xp.cos(theta), xp.sin(phi), xp.cos(phi)
        k, turn = yaw_rate * st, yaw_rate * ct
        spin, lean = wheel_rate - k, pitch_rate - k
        p, q = -cf * roll - sf * turn, -sf * roll + cf * turn
        # Angular momentum of frame and disc along the pole.
        pole = FRAME_Z * q + DISC_SPIN * (q + disc_rate)

        # Forward: wheel and lean.
        m_ss, m_sl = WHEEL_SPIN + r * r * (WHEEL + mass), r * moment * cf
        m_ll = along + second
        pushed = cf * q * p - sf * (p * p + lean * lean)
        h_s = on_wheel + (WHEEL + mass) * r * r * turn * roll - r * moment * pushed
        h_l = (
            -on_wheel
            + p * (pole - across * q)
            + g * moment * sf * ct
            + moment * r * (cf * turn * roll + sf * (k * spin - roll * roll))
            - second * q * p
        )
        forward = m_ss * m_ll - m_sl * m_sl
        of_spin = (m_ll * h_s - m_sl * h_l) / forward
        of_lean = (m_ss * h_l - m_sl * h_s) / forward

        # Sideways: roll and turn.
        raised = mass * r * r + 2 * r * cf * moment + cf * cf * second
        aside = r * moment + cf * second
        m_rr = WHEEL_TURN + WHEEL * r * r + raised + across * cf * cf + FRAME_Z * sf * sf
        m_rt = aside * sf + (across - FRAME_Z) * cf * sf
        m_tt = WHEEL_TURN + second * sf * sf + across * sf * sf + FRAME_Z * cf * cf
        # What the two moments of frame and disc have beside their angular accelerations.
        about_x = -across * pitch_rate * q + lean * (pole - along * q)
        about_z = FRAME_Z * pitch_rate * p + on_disc + p * lean * (along - across)
        bent, drawn = q * (2 * lean + k), r * spin * turn
        h_r = (
            g * st * ((WHEEL + mass) * r + cf * moment)
            - WHEEL_TURN * k * turn
            - WHEEL_SPIN * turn * spin
            - WHEEL * r * drawn
            # (r + h cos) (r turn spin + h bent), summed over the masses at h.
            - (mass * r + moment * cf) * drawn
            - aside * bent
            + cf * about_x
            + sf * about_z
        )
        h_t = (
            g * moment * sf * st
            + WHEEL_SPIN * roll * spin
            + WHEEL_TURN * k * roll
            - sf * (moment * drawn + second * bent)
            + sf * about_x
            - cf * about_z
        )
        sideways = m_rr * m_tt - m_rt * m_rt
        of_roll = (m_tt * h_r - m_rt * h_t) / sideways
        of_turn = (m_rr * h_t - m_rt * h_r) / sideways

        of_q = -sf * of_roll + cf * of_turn + pitch_rate * p
        of_yaw = (of_turn + k * roll) / ct
        of_k = of_yaw * st + turn * roll
        return (
            *(roll, of_roll, yaw_rate, of_yaw, wheel_rate, of_spin + of_k),
            *(pitch_rate, of_lean + of_k, disc_rate, on_disc / DISC_SPIN - of_q),
            *(r * wheel_rate * xp.cos(yaw), r * wheel_rate * xp.sin(yaw)),
        )

    return derivative
