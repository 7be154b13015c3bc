"""The same computations as compiled scalar code, as a careful C programmer writes them: numba.

One learner after another, the gradient by hand, sizes known to the compiler, memory allocated once,
no fast-math.  ``mean_kernel`` and ``covariance_kernel`` are value and gradient, ``ticks`` is whole
ticks of the bicycle.  Conventions as in ``benchmarks.peers_jax``; the unroll is s += D s with
D = dt (W_s + W_a theta) and, with covariance, X' = A X A' + nu of the second moment with A = 1 + D.

Inner loops run along rows, so that the compiler can use vector instructions without changing the
order of a sum; that and sizes known to it make this up to 2.5 times as fast as the plain loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit  # pyright: ignore[reportMissingImports] (an extra)

from benchmarks.paper import (
    ACTION_SCALE,
    ALPHA,
    BEHIND,
    BETA,
    CENTRE_TERM,
    DISTURBANCE,
    DT,
    EXPLORATION,
    FALLEN,
    FIT_RATE,
    GOAL,
    GOAL_RADIUS,
    GRAVITY_TERM,
    GYROSCOPIC_TERM,
    HEIGHT,
    HORIZON,
    LIMIT_TICKS,
    NOISE_RATE,
    SPIN_TERM,
    STATE_COST,
    STATE_SCALE,
    STOP,
    TORQUE_TERM,
    TRAVEL,
    TURN,
    TYRE_TERM,
    UNROLL_DT,
    WHEELBASE,
    WHEELBASE_TOLERANCE,
    M,
    N,
)

Array = np.ndarray[Any, Any]
EAST, NORTH = GOAL


LARGEST_KNOWN = 16
"""States up to which it helps that the compiler knows their number; at 32 it hinders, threefold."""


# Value and gradient.  A kernel does learners first..last-1 and is given all memory that it needs.


@cache
def mean_kernel(states: int, m: int) -> Any:  # noqa: C901 (loops, as scalar code has them)
    """Compiled for n states and m actions: see ``mean``."""
    known = states if states <= LARGEST_KNOWN else 0

    @njit(fastmath=False, cache=True)
    def kernel(  # noqa: C901
        first, last, weight, theta, start, cost, weights, dt, squares, path, vectors, G, V, g
    ):
        n = known if known > 0 else start.shape[1]
        steps = weights.shape[0]
        D, transposed = squares[0], squares[1]
        adjoint, pull, pulled = vectors[0], vectors[1], vectors[2]
        for b in range(first, last):
            for i in range(n):
                for j in range(n):
                    D[i, j] = weight[b, i, j]
                    G[i, j] = 0
                for k in range(m):
                    for j in range(n):
                        D[i, j] += weight[b, i, n + k] * theta[b, k, j]
                for j in range(n):
                    D[i, j] *= dt
                    transposed[j, i] = D[i, j]
                path[0, i] = start[b, i]
                adjoint[i] = 0
            for t in range(steps):
                for i in range(n):
                    path[t + 1, i] = path[t, i]
                for j in range(n):
                    x = path[t, j]
                    for i in range(n):
                        path[t + 1, i] += transposed[j, i] * x
            value = dt - dt  # 0 in the precision of everything else
            for t in range(steps, 0, -1):
                for i in range(n):
                    pull[i] = 0
                for j in range(n):
                    x = weights[t - 1] * path[t, j]
                    for i in range(n):
                        pull[i] += cost[j, i] * x
                for i in range(n):
                    value -= pull[i] * path[t, i]
                    pulled[i] = adjoint[i] - pull[i] - pull[i]
                for j in range(n):
                    x = adjoint[j]
                    for i in range(n):
                        pulled[i] += D[j, i] * x
                for i in range(n):
                    x = pulled[i]
                    adjoint[i] = x
                    for j in range(n):
                        G[i, j] += x * path[t - 1, j]
            V[b] = value
            for k in range(m):
                for j in range(n):
                    g[b, k, j] = 0
                for i in range(n):
                    x = dt * weight[b, i, n + k]
                    for j in range(n):
                        g[b, k, j] += x * G[i, j]

    return kernel


@cache
def covariance_kernel(states: int, m: int) -> Any:  # noqa: C901
    """Compiled for n states and m actions: see ``covariance``."""
    known = states if states <= LARGEST_KNOWN else 0

    @njit(fastmath=False, cache=True)
    def kernel(  # noqa: C901
        first, last, weight, theta, start, noise, cost, weights, dt, D, squares, products, G, V, g
    ):
        n = known if known > 0 else start.shape[1]
        steps = weights.shape[0]
        transposed, X, half = squares[0], squares[1], squares[2]
        for b in range(first, last):
            for i in range(n):
                for j in range(n):
                    D[i, j] = weight[b, i, j]
                    G[i, j] = 0
                    X[i, j] = start[b, i] * start[b, j]
                for k in range(m):
                    for j in range(n):
                        D[i, j] += weight[b, i, n + k] * theta[b, k, j]
                for j in range(n):
                    D[i, j] *= dt
                    transposed[j, i] = D[i, j]
            value = dt - dt  # 0 in the precision of everything else
            for t in range(steps):
                P = products[t]  # A X
                for i in range(n):
                    for j in range(n):
                        P[i, j] = X[i, j]
                    for k in range(n):
                        x = D[i, k]
                        for j in range(n):
                            P[i, j] += x * X[k, j]
                trace = dt - dt
                for i in range(n):
                    for j in range(n):
                        X[i, j] = P[i, j] + noise[b, i, j]
                    for k in range(n):
                        x = P[i, k]
                        for j in range(n):
                            X[i, j] += x * transposed[k, j]
                    for j in range(n):
                        trace += cost[i, j] * X[i, j]
                value -= weights[t] * trace
            V[b] = value
            # From here on X holds the adjoint Lambda.
            for i in range(n):
                for j in range(n):
                    X[i, j] = weights[steps - 1] * cost[i, j]
            for t in range(steps - 1, -1, -1):
                P = products[t]
                for i in range(n):
                    for k in range(n):
                        x = X[i, k]
                        for j in range(n):
                            G[i, j] += x * P[k, j]
                if t == 0:
                    break
                for i in range(n):
                    for j in range(n):
                        half[i, j] = X[i, j]
                    for k in range(n):
                        x = X[i, k]
                        for j in range(n):
                            half[i, j] += x * D[k, j]
                for i in range(n):
                    for j in range(n):
                        X[i, j] = half[i, j] + weights[t - 1] * cost[i, j]
                    for k in range(n):
                        x = transposed[i, k]
                        for j in range(n):
                            X[i, j] += x * half[k, j]
            for k in range(m):
                for j in range(n):
                    g[b, k, j] = 0
                for i in range(n):
                    x = dt * weight[b, i, n + k]
                    x = -x - x
                    for j in range(n):
                        g[b, k, j] += x * G[i, j]

    return kernel


Peer = Callable[..., tuple[Array, Array]]


def mean(n: int, m: int, steps: int, dtype: Any) -> Peer:
    """Value and gradient, mean only, for n states, m actions and T steps.

    Of weight ``[B, n, n + m]``, theta ``[B, m, n]``, start ``[B, n]``, cost, weights, dt.
    """
    kernel = mean_kernel(n, m)
    memory = [np.empty(shape, dtype) for shape in ((2, n, n), (steps + 1, n), (3, n), (n, n))]

    def value_and_gradient(
        weight: Array, theta: Array, start: Array, cost: Array, weights: Array, dt: Any
    ) -> tuple[Array, Array]:
        V, g = np.empty(len(start), dtype), np.empty_like(theta)
        kernel(0, len(start), weight, theta, start, cost, weights, dt, *memory, V, g)
        return V, g

    return value_and_gradient


def covariance(n: int, m: int, steps: int, dtype: Any) -> Peer:
    """The same with covariance; noise ``[B, n, n]`` after start."""
    kernel = covariance_kernel(n, m)
    memory = [np.empty(shape, dtype) for shape in ((n, n), (3, n, n), (steps, n, n), (n, n))]

    def value_and_gradient(
        weight: Array,
        theta: Array,
        start: Array,
        noise: Array,
        cost: Array,
        weights: Array,
        dt: Any,
    ) -> tuple[Array, Array]:
        V, g = np.empty(len(start), dtype), np.empty_like(theta)
        kernel(0, len(start), weight, theta, start, noise, cost, weights, dt, *memory, V, g)
        return V, g

    return value_and_gradient


# Whole ticks of the bicycle, in float64.


@njit(fastmath=False, cache=True)
def _half_chord(direction, curvature):
    """Half the angle of the arc that a tyre makes in a tick, with the sign of its direction."""
    chord = math.asin(min(1.0, abs(curvature) * (TRAVEL / (2 * WHEELBASE))))
    if direction > 0:
        return chord
    return -chord if direction < 0 else 0.0


@njit(fastmath=False, cache=True)
def bicycle_step(world, torque, displacement):
    """Move the bicycle ``[10]`` by a tick; displacement with its disturbance."""
    theta, theta_dot, omega, omega_dot, psi = world[0], world[1], world[2], world[3], world[5]
    sine, tangent = math.sin(theta), math.tan(theta)
    centre = tangent / math.sqrt(BEHIND * BEHIND * tangent * tangent + WHEELBASE * WHEELBASE)
    phi = omega + math.atan(displacement / HEIGHT)
    turning = GYROSCOPIC_TERM * theta_dot + TYRE_TERM * (sine + tangent) + CENTRE_TERM * centre
    omega_ddot = GRAVITY_TERM * math.sin(phi) - math.cos(phi) * turning
    theta_ddot = TORQUE_TERM * torque - SPIN_TERM * omega_dot

    omega_dot += DT * omega_ddot
    theta_dot += DT * theta_ddot
    theta = min(max(theta + DT * theta_dot, -STOP), STOP)

    front = psi + theta
    front += _half_chord(front, sine)
    back = psi + _half_chord(psi, tangent)
    xf, yf = world[6] - TRAVEL * math.sin(front), world[7] + TRAVEL * math.cos(front)
    xb, yb = world[8] - TRAVEL * math.sin(back), world[9] + TRAVEL * math.cos(back)
    dx, dy = xf - xb, yf - yb
    distance = math.sqrt(dx * dx + dy * dy)
    gap = WHEELBASE - distance
    if abs(gap) > WHEELBASE_TOLERANCE:
        xb -= dx * gap / distance
        yb -= dy * gap / distance

    world[0], world[1], world[2], world[3] = theta, theta_dot, omega + DT * omega_dot, omega_dot
    world[4], world[5] = omega_ddot, math.atan2(-dx, dy)
    world[6], world[7], world[8], world[9] = xf, yf, xb, yb


@njit(fastmath=False, cache=True)
def observe(world, observation):
    """What the rider sees, scaled, into ``[5]``."""
    ux, uy, wx, wy = world[6] - world[8], world[7] - world[9], EAST - world[6], NORTH - world[7]
    observation[0] = world[2] / STATE_SCALE[0]
    observation[1] = world[3] / STATE_SCALE[1]
    observation[2] = world[0] / STATE_SCALE[2]
    observation[3] = world[1] / STATE_SCALE[3]
    observation[4] = math.atan2(ux * wy - uy * wx, ux * wx + uy * wy) / STATE_SCALE[4]


@njit(fastmath=False, cache=True)
def bicycle_start(world, uniform):
    """Put it upright at the origin, the heading from a uniform number."""
    psi = -math.pi + 2 * math.pi * uniform
    for i in range(10):
        world[i] = 0.0
    world[5], world[6], world[7] = psi, -math.sin(psi) * WHEELBASE, math.cos(psi) * WHEELBASE


ORDER = (
    "world",
    "observation",
    "weight",
    "theta",
    "noise",
    "ticks",
    "episodes",
    "falls",
    "rides",
)
"""The first arguments of ``ticks``, by the names of ``benchmarks.bicycle.numbers``."""

_mean = mean_kernel(N, M)
_covariance = covariance_kernel(N, M)


@njit(fastmath=False, cache=True)
def ticks(  # noqa: C901
    world, observation, weight, theta, noise, age, episodes, falls, rides, uniform, normal, values
):
    """K ticks of B learners, in place, from uniforms and normals ``[K, B, 2]``.

    world ``[B, 10]``, observation ``[B, 5]``, weight ``[B, 5, 7]``, theta ``[B, 2, 5]``, noise per
    second ``[B, 5, 5]`` (``[0, 5, 5]`` without covariance); age: ticks of the episode, and counts
    of episodes ``[B]``; values ``[K, B]`` are written.
    """
    with_covariance = noise.shape[0] > 0
    D, G, over_step = np.empty((N, N)), np.empty((N, N)), np.empty((len(world), N, N))
    states, vectors = np.empty((HORIZON + 1, N)), np.empty((3, N))
    squares, products = np.empty((3, N, N)), np.empty((HORIZON, N, N))
    gradients = np.empty((len(world), M, N))
    cost, weights = np.zeros((N, N)), np.full(HORIZON, UNROLL_DT)
    for i in range(N):
        cost[i, i] = STATE_COST[i]
    phi, residual, action = np.empty(N + M), np.empty(N), np.empty(M)
    for b in range(len(world)):
        for k in range(len(uniform)):
            for i in range(N):
                phi[i] = observation[b, i]
            for i in range(M):
                x = EXPLORATION * normal[k, b, i]
                for j in range(N):
                    x += theta[b, i, j] * phi[j]
                action[i] = min(max(x, -1.0), 1.0)
                phi[N + i] = action[i]
            disturbance = (2 * uniform[k, b, 0] - 1) * DISTURBANCE
            bicycle_step(
                world[b], action[0] * ACTION_SCALE[0], action[1] * ACTION_SCALE[1] + disturbance
            )
            observe(world[b], observation[b])

            for i in range(N):
                moved = observation[b, i] - phi[i]
                if i == N - 1:
                    moved -= TURN * round(moved / TURN)
                x = moved / DT
                for j in range(N + M):
                    x -= weight[b, i, j] * phi[j]
                residual[i] = x
                rate = FIT_RATE * np.sign(x)
                for j in range(N + M):
                    weight[b, i, j] += rate * phi[j]

            if with_covariance:
                for i in range(N):
                    for j in range(N):
                        squared = DT * residual[i] * residual[j]
                        noise[b, i, j] += NOISE_RATE * (squared - noise[b, i, j])
                        over_step[b, i, j] = UNROLL_DT * noise[b, i, j]
                _covariance(
                    b,
                    b + 1,
                    weight,
                    theta,
                    observation,
                    over_step,
                    cost,
                    weights,
                    UNROLL_DT,
                    D,
                    squares,
                    products,
                    G,
                    values[k],
                    gradients,
                )
            else:
                _mean(
                    b,
                    b + 1,
                    weight,
                    theta,
                    observation,
                    cost,
                    weights,
                    UNROLL_DT,
                    squares,
                    states,
                    vectors,
                    G,
                    values[k],
                    gradients,
                )
            square = 0.0
            for i in range(M):
                for j in range(N):
                    square += gradients[b, i, j] * gradients[b, i, j]
            rate = ALPHA / (BETA + math.sqrt(square))
            for i in range(M):
                for j in range(N):
                    theta[b, i, j] += rate * gradients[b, i, j]

            age[b] += 1
            east, north = world[b, 6] - EAST, world[b, 7] - NORTH
            fell = not abs(world[b, 2]) <= FALLEN
            arrived = east * east + north * north <= GOAL_RADIUS * GOAL_RADIUS
            if fell or arrived or age[b] >= LIMIT_TICKS:
                episodes[b] += 1
                if fell:
                    falls[b] += 1
                else:
                    rides[b] += 1
                age[b] = 0
                bicycle_start(world[b], uniform[k, b, 1])
                observe(world[b], observation[b])
