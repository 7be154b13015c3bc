"""Mechanics of a planar biped of five links on one point foot: equations of motion, knee stops,
the strike of the other foot.

All functions are over rows (``sims.rows``).  q: leans from upright, rad, positive forward, of
stance shank, stance thigh, torso, swing thigh, swing shank, a link's lean being that of its upper
end over its lower one; v: their rates.  The stance foot is pinned.  u: torques, N m, of the stance
leg's knee and hip and of the swing leg's hip and knee, positive on shank and thigh, with the
reaction on thigh and torso.

Constants: RABBIT, from E. R. Westervelt, J. W. Grizzle and D. E. Koditschek, "Hybrid zero dynamics
of planar biped walkers", IEEE Transactions on Automatic Control 48(1), 2003, as given in
``getPhysicalParameters.m`` of M. P. Kelly's OptimTraj (``demo/fiveLinkBiped``); without the inertia
of rotors and without friction.
"""

from __future__ import annotations

import numpy as np

from sims.rows import Function, Namespace

MASSES = (3.2, 6.8, 20.0, 6.8, 3.2)
"""kg."""
INERTIAS = (0.93, 1.08, 2.22, 1.08, 0.93)
"""About each centre of mass, kg m^2."""
SHANK, THIGH, TORSO = 0.4, 0.4, 0.625
"""Lengths, m; that of the torso is for pictures."""
GRAVITY = 9.81
"""m/s^2."""
_SHANK_CENTRE, _THIGH_CENTRE, _TORSO_CENTRE = 0.128, 0.163, 0.2
"""m of the centres of mass below knee and hip, and above the hip."""

CENTRES = np.array(
    [
        [SHANK - _SHANK_CENTRE, 0, 0, 0, 0],
        [SHANK, THIGH - _THIGH_CENTRE, 0, 0, 0],
        [SHANK, THIGH, _TORSO_CENTRE, 0, 0],
        [SHANK, THIGH, 0, -_THIGH_CENTRE, 0],
        [SHANK, THIGH, 0, -THIGH, -_SHANK_CENTRE],
    ]
)
"""m: link k has its centre of mass sum_j CENTRES[k, j] (sin q_j, cos q_j) from the stance foot."""

_D = CENTRES.T @ np.diag(MASSES) @ CENTRES + np.diag(INERTIAS)
_MASS = sum(MASSES)
D00, D10, D20, D30, D40 = map(float, _D[:, 0])
D11, D21, D31, D41 = map(float, _D[1:, 1])
D22, D33, D43, D44 = float(_D[2, 2]), float(_D[3, 3]), float(_D[4, 3]), float(_D[4, 4])
G0, G1, G2, G3, G4 = map(float, np.array(MASSES) @ CENTRES)

TOUCH, REST = 1e-10, 1e-8
"""A knee is at its stop within these, rad and rad/s."""
SLOW = 1e-3
"""rad/s: a knee at its stop that the hit of the other one would open by less is held closed.  Else
two knees may hit in turns for ever, each time by a fiftieth of the rate before."""


def foot_over(xp: Namespace) -> Function:
    """Of the swing foot from the stance foot: a function of (q, v) that gives its place and
    velocity, forward and up: m, m/s."""

    @xp.jit
    def foot(q, v):
        s0, s1, s3, s4 = xp.sin(q[0]), xp.sin(q[1]), xp.sin(q[3]), xp.sin(q[4])
        c0, c1, c3, c4 = xp.cos(q[0]), xp.cos(q[1]), xp.cos(q[3]), xp.cos(q[4])
        return (
            SHANK * (s0 - s4) + THIGH * (s1 - s3),
            SHANK * (c0 - c4) + THIGH * (c1 - c3),
            SHANK * (c0 * v[0] - c4 * v[4]) + THIGH * (c1 * v[1] - c3 * v[3]),
            SHANK * (s4 * v[4] - s0 * v[0]) + THIGH * (s3 * v[3] - s1 * v[1]),
        )

    return foot


def knees_over(xp: Namespace) -> Function:
    """Which knees are at their stops: a function of (q, v) that gives 1.0 or 0.0 for the stance
    and for the swing leg."""

    @xp.jit
    def at_stop(gap, rate):
        return xp.as_number(xp.both(gap <= TOUCH, xp.abs(rate) <= REST))

    return xp.jit(
        lambda q, v: (at_stop(q[0] - q[1], v[0] - v[1]), at_stop(q[4] - q[3], v[4] - v[3]))
    )


def accelerations_over(xp: Namespace) -> Function:
    """The accelerations (rad/s^2) of the five leans: a function of (q, v, u, stops), the last two
    numbers, those of ``knees_over``.

        sum_j D_ij (cos(q_i - q_j) a_j + sin(q_i - q_j) v_j^2) - g G_i sin q_i = B u + J' force

    A stop's force is at least zero, and zero where its knee opens: a linear complementarity
    problem, whose matrix J M^-1 J' is positive definite, so it has one solution.
    """
    solve_stopped, pairs = _solve_stopped_over(xp), _pairs_over(xp)

    @xp.jit
    def accelerations(q, v, u, stops):
        sines, _, across, aside = pairs(q)
        w0, w1, w2, w3, w4 = v[0] * v[0], v[1] * v[1], v[2] * v[2], v[3] * v[3], v[4] * v[4]
        # D_ij sin(q_i - q_j), antisymmetric.
        a10, a20, a30, a40, a21, a31, a41, a43 = aside
        s0, s1, s2, s3, s4 = sines
        force = (
            u[0] + GRAVITY * G0 * s0 + a10 * w1 + a20 * w2 + a30 * w3 + a40 * w4,
            u[1] - u[0] + GRAVITY * G1 * s1 - a10 * w0 + a21 * w2 + a31 * w3 + a41 * w4,
            -u[1] - u[2] + GRAVITY * G2 * s2 - a20 * w0 - a21 * w1,
            u[2] - u[3] + GRAVITY * G3 * s3 - a30 * w0 - a31 * w1 + a43 * w4,
            u[3] + GRAVITY * G4 * s4 - a40 * w0 - a41 * w1 - a43 * w3,
        )
        nothing = 0.0 * w0
        still = (nothing, nothing, nothing, nothing, nothing)
        return solve_stopped(across, force, still, stops, 0.0)

    return accelerations


def impact_over(xp: Namespace) -> Function:
    """Rates after an impact: a function of (q, v, foot velocity, stops).

    The foot's velocity, forward and up, is that of the point that is the stance foot from now on,
    before the impact; zero where no foot strikes.  ``stops``: knees at their stops, which impulses
    keep from closing, as the forces of ``accelerations_over``.  With M from there,

        M v+ = M v- + G_i (cos q_i, -sin q_i) . (foot velocity) + J' impulse
    """
    solve_stopped, pairs = _solve_stopped_over(xp), _pairs_over(xp)

    @xp.jit
    def impact(q, v, east, up, stops):
        sines, cosines, across, _ = pairs(q)
        s0, s1, s2, s3, s4 = sines
        c0, c1, c2, c3, c4 = cosines
        push = (
            G0 * (c0 * east - s0 * up),
            G1 * (c1 * east - s1 * up),
            G2 * (c2 * east - s2 * up),
            G3 * (c3 * east - s3 * up),
            G4 * (c4 * east - s4 * up),
        )
        return solve_stopped(across, push, v, stops, SLOW)

    return impact


def ground_over(xp: Namespace) -> Function:
    """The force of the ground on the stance foot, forward and up, N: a function of (q, v,
    accelerations)."""

    @xp.jit
    def ground(q, v, a):
        s0, s1, s2, s3, s4 = xp.sin(q[0]), xp.sin(q[1]), xp.sin(q[2]), xp.sin(q[3]), xp.sin(q[4])
        c0, c1, c2, c3, c4 = xp.cos(q[0]), xp.cos(q[1]), xp.cos(q[2]), xp.cos(q[3]), xp.cos(q[4])
        w0, w1, w2, w3, w4 = v[0] * v[0], v[1] * v[1], v[2] * v[2], v[3] * v[3], v[4] * v[4]
        forward = (
            G0 * (c0 * a[0] - s0 * w0)
            + G1 * (c1 * a[1] - s1 * w1)
            + G2 * (c2 * a[2] - s2 * w2)
            + G3 * (c3 * a[3] - s3 * w3)
            + G4 * (c4 * a[4] - s4 * w4)
        )
        down = (
            G0 * (s0 * a[0] + c0 * w0)
            + G1 * (s1 * a[1] + c1 * w1)
            + G2 * (s2 * a[2] + c2 * w2)
            + G3 * (s3 * a[3] + c3 * w3)
            + G4 * (s4 * a[4] + c4 * w4)
        )
        return forward, _MASS * GRAVITY - down

    return ground


def _pairs_over(xp: Namespace) -> Function:
    """Of q: sines, cosines, and D_ij cos(q_i - q_j) and D_ij sin(q_i - q_j) for (i, j) of 10, 20,
    30, 40, 21, 31, 41, 43; torso and swing leg (32, 42) have D = 0."""

    @xp.jit
    def pairs(q):
        s0, s1, s2, s3, s4 = xp.sin(q[0]), xp.sin(q[1]), xp.sin(q[2]), xp.sin(q[3]), xp.sin(q[4])
        c0, c1, c2, c3, c4 = xp.cos(q[0]), xp.cos(q[1]), xp.cos(q[2]), xp.cos(q[3]), xp.cos(q[4])
        across = (
            D10 * (c1 * c0 + s1 * s0),
            D20 * (c2 * c0 + s2 * s0),
            D30 * (c3 * c0 + s3 * s0),
            D40 * (c4 * c0 + s4 * s0),
            D21 * (c2 * c1 + s2 * s1),
            D31 * (c3 * c1 + s3 * s1),
            D41 * (c4 * c1 + s4 * s1),
            D43 * (c4 * c3 + s4 * s3),
        )
        aside = (
            D10 * (s1 * c0 - c1 * s0),
            D20 * (s2 * c0 - c2 * s0),
            D30 * (s3 * c0 - c3 * s0),
            D40 * (s4 * c0 - c4 * s0),
            D21 * (s2 * c1 - c2 * s1),
            D31 * (s3 * c1 - c3 * s1),
            D41 * (s4 * c1 - c4 * s1),
            D43 * (s4 * c3 - c4 * s3),
        )
        return (s0, s1, s2, s3, s4), (c0, c1, c2, c3, c4), across, aside

    return pairs


def _solve_stopped_over(xp: Namespace) -> Function:
    """x = x0 + M^-1 (r + J' f), f complementary to J x over the knees at their stops: a function of
    (the entries of M as of ``_pairs_over``, r, x0, stops, slow).  Where one knee's f would open the
    other by less than ``slow``, both are held.

    J has the rows (1, -1, 0, 0, 0) and (0, 0, 0, -1, 1).  M is factored as L D L', torso and swing
    leg first.
    """

    @xp.jit
    def solved(factors, r0, r1, r2, r3, r4):
        l20, l21, l43, l41, l40, l31, l30, l10, p3, p1, p0 = factors
        r3 = r3 - l43 * r4
        r1 = r1 - l21 * r2 - l41 * r4 - l31 * r3
        r0 = r0 - l20 * r2 - l40 * r4 - l30 * r3 - l10 * r1
        x0 = r0 / p0
        x1 = r1 / p1 - l10 * x0
        x3 = r3 / p3 - l31 * x1 - l30 * x0
        x4 = r4 / D44 - l43 * x3 - l41 * x1 - l40 * x0
        return x0, x1, r2 / D22 - l21 * x1 - l20 * x0, x3, x4

    @xp.jit
    def forces(w_1, w_2, a_11, a_12, a_22, stops, slow):
        # f >= 0, w + A f >= 0 where there is a stop, f = 0 elsewhere; by enumeration.
        on_1, on_2 = stops[0] > 0.5, stops[1] > 0.5
        determinant = a_11 * a_22 - a_12 * a_12
        both_1 = (a_12 * w_2 - a_22 * w_1) / determinant
        both_2 = (a_12 * w_1 - a_11 * w_2) / determinant
        alone_1 = xp.where(on_1, xp.maximum(-w_1 / a_11, 0.0), 0.0)
        alone_2 = xp.where(on_2, xp.maximum(-w_2 / a_22, 0.0), 0.0)
        open_1, open_2 = w_1 + a_12 * alone_2, w_2 + a_12 * alone_1
        slow_1 = xp.both(alone_2 > 0.0, xp.both(open_1 >= 0.0, open_1 < slow))
        slow_2 = xp.both(alone_1 > 0.0, xp.both(open_2 >= 0.0, open_2 < slow))
        press = xp.either(xp.both(both_1 > 0.0, both_2 > 0.0), xp.either(slow_1, slow_2))
        both = xp.both(xp.both(on_1, on_2), press)
        first = xp.both(alone_1 > 0.0, xp.either(xp.negated(on_2), open_2 >= 0.0))
        return (
            xp.where(both, both_1, xp.where(first, alone_1, 0.0)),
            xp.where(both, both_2, xp.where(first, 0.0, alone_2)),
        )

    @xp.jit
    def solve_stopped(across, r, x, stops, slow):
        m10, m20, m30, m40, m21, m31, m41, m43 = across
        l20, l21 = m20 / D22, m21 / D22
        l43, l41, l40 = m43 / D44, m41 / D44, m40 / D44
        p3, a31, a30 = D33 - l43 * m43, m31 - l43 * m41, m30 - l43 * m40
        l31, l30 = a31 / p3, a30 / p3
        p1 = D11 - l21 * m21 - l41 * m41 - l31 * a31
        a10 = m10 - l21 * m20 - l41 * m40 - l31 * a30
        l10 = a10 / p1
        p0 = D00 - l20 * m20 - l40 * m40 - l30 * a30 - l10 * a10
        factors = (l20, l21, l43, l41, l40, l31, l30, l10, p3, p1, p0)
        f0, f1, f2, f3, f4 = solved(factors, r[0], r[1], r[2], r[3], r[4])
        f0, f1, f2, f3, f4 = x[0] + f0, x[1] + f1, x[2] + f2, x[3] + f3, x[4] + f4
        y0, y1, y2, y3, y4 = solved(factors, 1.0, -1.0, 0.0, 0.0, 0.0)
        z0, z1, z2, z3, z4 = solved(factors, 0.0, 0.0, 0.0, -1.0, 1.0)
        k, m = forces(f0 - f1, f4 - f3, y0 - y1, z0 - z1, z4 - z3, stops, slow)
        return (
            f0 + k * y0 + m * z0,
            f1 + k * y1 + m * z1,
            f2 + k * y2 + m * z2,
            f3 + k * y3 + m * z3,
            f4 + k * y4 + m * z4,
        )

    return solve_stopped
