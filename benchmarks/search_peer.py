"""The peer of ``benchmarks/search.py``: footnote 1's bicycle as compiled scalar code.

One episode after the other, everything in registers, with the equations of
``sims.bicycle.physics`` and the numbers of ``edtorch.run.hashing``.
"""

from __future__ import annotations

import math

import numba  # pyright: ignore[reportMissingImports]
import numpy as np

V, G, D_CM, C, H, L = 10 / 3.6, 9.82, 0.30, 0.66, 0.94, 1.11
M_C, M_D, M_P, R = 15.0, 1.7, 60.0, 0.34
THETA_MAX, OMEGA_MAX, DT = 1.3963, math.pi / 15, 0.01
I_B = 13 / 3 * M_C * H * H + M_P * (H + D_CM) ** 2
I_D = M_D * R * R
SPIN = V / R
LIMIT, GOAL, RADIUS = 60_000, 1000.0, 2.0
FAILED, SUCCEEDED, TIMED_OUT = 1, 2, 3


@numba.njit(cache=True)
def mix(word):
    word ^= word >> 16
    word = (word * 0x21F0AAAD) & 0xFFFFFFFF
    word ^= word >> 15
    word = (word * 0x735A2D97) & 0xFFFFFFFF
    return word ^ (word >> 15)


@numba.njit(cache=True)
def ride(weight, key0, key1, limit):
    """Outcome and ticks of one episode of the policy ``weight`` [2, 5], of at most ``limit``."""
    theta = theta_dot = omega = omega_dot = psi = xb = yb = xf = 0.0
    yf = L
    for tick in range(1, limit + 1):
        ux, uy, wx, wy = xf - xb, yf - yb, GOAL - xf, -yf
        angle = math.atan2(ux * wy - uy * wx, ux * wx + uy * wy) / math.pi
        f0, f1, f2, f3 = omega / 0.15, omega_dot / 0.25, theta / 0.5, theta_dot / 2.0
        torque = 2.0 * (
            weight[0, 0] * f0
            + weight[0, 1] * f1
            + weight[0, 2] * f2
            + weight[0, 3] * f3
            + weight[0, 4] * angle
        )
        shift = 0.02 * (
            weight[1, 0] * f0
            + weight[1, 1] * f1
            + weight[1, 2] * f2
            + weight[1, 3] * f3
            + weight[1, 4] * angle
        )
        # A tick has two numbers: the disturbance, and one for a restart.
        uniform = mix((mix((2 * tick) ^ key0) + key1) & 0xFFFFFFFF) * 2.0**-32
        shift += uniform * 0.04 - 0.02

        sine = math.sin(theta)
        tangent = sine / abs(math.cos(theta))
        centre = tangent / math.sqrt(tangent * tangent * (L - C) ** 2 + L * L)
        turning = (sine + tangent) * (V * V * M_D * R / (L * I_B)) + centre * (
            V * V * (M_C + M_P) * H / I_B
        )
        phi = omega + math.atan(shift / H)
        omega_ddot = math.sin(phi) * (H * (M_C + M_P) * G / I_B) - math.cos(phi) * (
            theta_dot * (I_D * SPIN / I_B) + turning
        )
        theta_ddot = torque / (0.5 * I_D) - omega_dot * (3 * SPIN)
        omega_dot += DT * omega_ddot
        theta_dot += DT * theta_ddot
        omega += DT * omega_dot
        theta = min(max(theta + DT * theta_dot, -THETA_MAX), THETA_MAX)

        direction = psi + theta
        direction += np.sign(direction) * math.asin(min(abs(sine) * (V * DT / (2 * L)), 1.0))
        xf -= V * DT * math.sin(direction)
        yf += V * DT * math.cos(direction)
        direction = psi + np.sign(psi) * math.asin(min(abs(tangent) * (V * DT / (2 * L)), 1.0))
        xb -= V * DT * math.sin(direction)
        yb += V * DT * math.cos(direction)
        dx, dy = xf - xb, yf - yb
        distance = math.sqrt(dx * dx + dy * dy)
        if abs(L - distance) > 0.01:
            xb -= dx * (L - distance) / distance
            yb -= dy * (L - distance) / distance
        psi = math.atan2(-dx, dy)

        if not abs(omega) <= OMEGA_MAX:
            return FAILED, tick
        if (xf - GOAL) ** 2 + yf * yf <= RADIUS * RADIUS:
            return SUCCEEDED, tick
    return TIMED_OUT, limit


@numba.njit(cache=True)
def search_serially(weights, keys):
    """Outcome and ticks [P, R] of the policies [P, 2, 5]; none runs on after it has failed."""
    policies, runs = keys.shape[:2]
    outcome = np.zeros((policies, runs), np.int8)
    ticks = np.zeros((policies, runs), np.int64)
    for p in range(policies):
        for r in range(runs):
            outcome[p, r], ticks[p, r] = ride(weights[p], keys[p, r, 0], keys[p, r, 1], LIMIT)
            if outcome[p, r] == FAILED:
                break
    return outcome, ticks
