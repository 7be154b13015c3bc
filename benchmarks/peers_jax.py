"""The same computations in JAX, as its users write them: one learner, vmapped, scanned, jitted.

``mean`` and ``covariance`` are the reference peer: the unroll as a ``lax.scan`` over time, its
gradient by ``jax.value_and_grad``, learners by ``vmap``.  ``covariance_own_jacobian`` spares
``jacrev``; ``mean_adjoint`` and ``covariance_adjoint`` are the gradient by hand, and ``..._last``
the same with the learners on the last axis, the fastest that was found for few states.  ``ticks``
is whole ticks of the bicycle, ``ticks_by_hand`` with that gradient.

All take the model ds/dt = W (s, theta s), weight W ``[B, n, n + m]``, theta ``[B, m, n]``, start
``[B, n]``, noise over one step ``[B, n, n]``, cost Q ``[n, n]``, weights w ``[T]`` and the seconds
dt of a step, and give V = -sum_tau w_tau (s_tau' Q s_tau + tr(Q Sigma_tau)) ``[B]`` and dV/dtheta.
There is no action cost.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

# One thread, as everybody else here; read when JAX starts.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import jax  # pyright: ignore[reportMissingImports] (an extra)
import jax.numpy as jnp  # pyright: ignore[reportMissingImports]
from jax import lax  # pyright: ignore[reportMissingImports]

from benchmarks import paper

# Without it JAX has no float64; arrays of float32 stay what they are.
jax.config.update("jax_enable_x64", True)

Array = Any
"""jax.Array; the checker need not have JAX."""


def array(numbers: Any, dtype: Any) -> Array:
    """An array of JAX's own."""
    return jnp.asarray(numbers, dtype)


def ready(result: Any) -> Any:
    """Wait for JAX, which computes behind one's back."""
    return jax.block_until_ready(result)


# Value and gradient, the JAX way: of one learner.


def _closed_loop(weight: Array, theta: Array, state: Array, dt: Array) -> Array:
    return state + dt * (weight @ jnp.concatenate([state, theta @ state]))


def mean_value(
    theta: Array, weight: Array, start: Array, cost: Array, weights: Array, dt: Array
) -> Array:
    """V along the mean, of one learner."""

    def step(state: Array, w: Array) -> tuple[Array, Array]:
        state = _closed_loop(weight, theta, state, dt)
        return state, -w * (state @ cost @ state)

    return lax.scan(step, start, weights)[1].sum()


def covariance_value(
    theta: Array,
    weight: Array,
    start: Array,
    noise: Array,
    cost: Array,
    weights: Array,
    dt: Array,
    own_jacobian: bool = False,
) -> Array:
    """V with the covariance to first order (equation 2), of one learner."""
    n = start.shape[0]
    loop = partial(_closed_loop, weight, theta, dt=dt)
    A = jnp.eye(n, dtype=start.dtype) + dt * (weight[:, :n] + weight[:, n:] @ theta)

    def step(belief: tuple[Array, Array], w: Array) -> tuple[tuple[Array, Array], Array]:
        state, cov = belief
        J = A if own_jacobian else jax.jacrev(loop)(state)
        state, cov = loop(state), J @ cov @ J.T + noise
        return (state, cov), -w * (state @ cost @ state + jnp.trace(cost @ cov))

    return lax.scan(step, (start, jnp.zeros((n, n), start.dtype)), weights)[1].sum()


@jax.jit
def mean(weight: Array, theta: Array, start: Array, cost: Array, weights: Array, dt: Array) -> Any:
    """Value and gradient, mean only, by differentiation."""
    one = jax.value_and_grad(mean_value)
    return jax.vmap(one, (0, 0, 0, None, None, None))(theta, weight, start, cost, weights, dt)


def _covariance(own_jacobian: bool) -> Callable[..., Any]:
    @jax.jit
    def both(
        weight: Array,
        theta: Array,
        start: Array,
        noise: Array,
        cost: Array,
        weights: Array,
        dt: Array,
    ) -> Any:
        one = jax.value_and_grad(partial(covariance_value, own_jacobian=own_jacobian))
        each = jax.vmap(one, (0, 0, 0, 0, None, None, None))
        return each(theta, weight, start, noise, cost, weights, dt)

    return both


covariance = _covariance(own_jacobian=False)
"""Value and gradient with covariance, by differentiation, the Jacobian by ``jax.jacrev``."""
covariance_own_jacobian = _covariance(own_jacobian=True)
"""The same with the closed loop's matrix for a Jacobian."""


# Value and gradient by hand: of one learner, vmapped.


def _adjoint_of_mean(
    weight: Array, theta: Array, start: Array, cost: Array, weights: Array, dt: Array
) -> Any:
    n = start.shape[0]
    D = dt * (weight[:, :n] + weight[:, n:] @ theta)

    def forward(before: Array, w: Array) -> Any:
        state = before + D @ before
        pull = w * (cost @ state)
        return state, (before, pull, -(pull @ state))

    def backward(carry: Any, step: Any) -> Any:
        adjoint, through = carry
        before, pull = step
        adjoint = adjoint + adjoint @ D - 2 * pull
        return (adjoint, through + jnp.outer(adjoint, before)), None

    _, (states, pulls, rewards) = lax.scan(forward, start, weights)
    nothing = (jnp.zeros_like(start), jnp.zeros_like(D))
    (_, through), _ = lax.scan(backward, nothing, (states, pulls), reverse=True)
    return rewards.sum(), dt * weight[:, n:].T @ through


def _adjoint_of_covariance(
    weight: Array,
    theta: Array,
    start: Array,
    noise: Array,
    cost: Array,
    weights: Array,
    dt: Array,
) -> Any:
    n = start.shape[0]
    A = jnp.eye(n, dtype=start.dtype) + dt * (weight[:, :n] + weight[:, n:] @ theta)

    def forward(moment: Array, w: Array) -> Any:
        product = A @ moment
        moment = product @ A.T + noise
        return moment, (product, -w * (cost * moment).sum())

    def backward(carry: Any, step: Any) -> Any:
        adjoint, through = carry
        product, w = step
        # adjoint: A' Lambda_{tau+1} A of the step after.
        adjoint = adjoint + w * cost
        return (A.T @ (adjoint @ A), through + adjoint @ product), None

    first = jnp.outer(start, start)
    _, (products, rewards) = lax.scan(forward, first, weights)
    nothing = (jnp.zeros_like(first), jnp.zeros_like(first))
    (_, through), _ = lax.scan(backward, nothing, (products, weights), reverse=True)
    return rewards.sum(), -2 * dt * weight[:, n:].T @ through


mean_adjoint = jax.jit(jax.vmap(_adjoint_of_mean, (0, 0, 0, None, None, None)))
"""Value and gradient, mean only, by hand."""
covariance_adjoint = jax.jit(jax.vmap(_adjoint_of_covariance, (0, 0, 0, 0, None, None, None)))
"""Value and gradient with covariance, by hand, through the second moment."""


# The same with the learners last: weight [n, n + m, B], theta [m, n, B], start [n, B], noise
# [n, n, B].  Sums are written out: as reductions or einsum they are up to a hundred times as slow.
# The price is that beyond about eight states XLA computes the same products over and over, with
# covariance for a second and more.

LARGEST_LAST = 8
"""States up to which ``covariance_adjoint_last`` is of any use."""


def _times(left: Array, right: Array) -> Array:
    """[i, k, B] times [k, j, B]."""
    return sum(left[:, k, None] * right[None, k] for k in range(right.shape[0]))


def _transposed_times(left: Array, right: Array) -> Array:
    """[k, i, B] transposed, times [k, j, B]."""
    return sum(left[k][:, None] * right[k][None] for k in range(right.shape[0]))


def _increment(weight: Array, theta: Array, dt: Array) -> Array:
    """D = A - 1."""
    n = weight.shape[0]
    return dt * (weight[:, :n] + _times(weight[:, n:], theta))


@jax.jit
def mean_adjoint_last(
    weight: Array, theta: Array, start: Array, cost: Array, weights: Array, dt: Array
) -> Any:
    """Value and gradient, mean only, by hand; all with the learners last."""
    D = _increment(weight, theta, dt)
    costs = jnp.broadcast_to(cost[:, :, None], D.shape)

    def forward(before: Array, w: Array) -> Any:
        state = before + _times(D, before[:, None])[:, 0]
        pull = w * _times(costs, state[:, None])[:, 0]
        return state, (before, pull, -(pull * state).sum(0))

    def backward(carry: Any, step: Any) -> Any:
        adjoint, through = carry
        before, pull = step
        adjoint = adjoint + _transposed_times(D, adjoint[:, None])[:, 0] - 2 * pull
        return (adjoint, through + adjoint[:, None] * before[None]), None

    _, (states, pulls, rewards) = lax.scan(forward, start, weights)
    nothing = (jnp.zeros_like(start), jnp.zeros_like(D))
    (_, through), _ = lax.scan(backward, nothing, (states, pulls), reverse=True)
    return rewards.sum(0), dt * _transposed_times(weight[:, len(start) :], through)


@jax.jit
def covariance_adjoint_last(
    weight: Array,
    theta: Array,
    start: Array,
    noise: Array,
    cost: Array,
    weights: Array,
    dt: Array,
) -> Any:
    """Value and gradient with covariance, by hand; all with the learners last."""
    D = _increment(weight, theta, dt)
    D_transposed = D.swapaxes(0, 1)

    def forward(moment: Array, w: Array) -> Any:
        product = moment + _times(D, moment)
        moment = product + _times(product, D_transposed) + noise
        return moment, (product, -w * (cost[:, :, None] * moment).sum((0, 1)))

    def backward(carry: Any, step: Any) -> Any:
        adjoint, through = carry
        product, w = step
        adjoint = adjoint + w * cost[:, :, None]
        half = adjoint + _times(adjoint, D)
        return (half + _times(D_transposed, half), through + _times(adjoint, product)), None

    first = start[:, None] * start[None]
    _, (products, rewards) = lax.scan(forward, first, weights)
    nothing = (jnp.zeros_like(first), jnp.zeros_like(first))
    (_, through), _ = lax.scan(backward, nothing, (products, weights), reverse=True)
    return rewards.sum(0), -2 * dt * _transposed_times(weight[:, len(start) :], through)


# Whole ticks of the bicycle.


class Population(NamedTuple):
    """Learners and their worlds, every array ``[B, ...]``; one of them where no B is said.

    world ``[10]`` in the order of ``sims.bicycle.physics.STATE``, float64; observation ``[5]``,
    weight ``[5, 7]``, theta ``[2, 5]`` and noise (per second, ``[5, 5]``, None without covariance)
    in the learner's precision; ticks of the episode, and counts of episodes.
    """

    world: Array
    observation: Array
    weight: Array
    theta: Array
    noise: Array | None
    ticks: Array
    episodes: Array
    falls: Array
    rides: Array


def bicycle_step(world: Array, torque: Array, displacement: Array) -> Array:
    """The bicycle a tick later; displacement with its disturbance."""
    theta, theta_dot, omega, omega_dot, _, psi, xf, yf, xb, yb = world
    sine, tangent = jnp.sin(theta), jnp.tan(theta)
    centre = tangent / jnp.sqrt((paper.BEHIND * tangent) ** 2 + paper.WHEELBASE**2)
    phi = omega + jnp.arctan(displacement / paper.HEIGHT)
    turning = (
        paper.GYROSCOPIC_TERM * theta_dot
        + paper.TYRE_TERM * (sine + tangent)
        + paper.CENTRE_TERM * centre
    )
    omega_ddot = paper.GRAVITY_TERM * jnp.sin(phi) - jnp.cos(phi) * turning
    theta_ddot = paper.TORQUE_TERM * torque - paper.SPIN_TERM * omega_dot

    omega_dot = omega_dot + paper.DT * omega_ddot
    omega = omega + paper.DT * omega_dot
    theta_dot = theta_dot + paper.DT * theta_ddot
    theta = jnp.clip(theta + paper.DT * theta_dot, -paper.STOP, paper.STOP)

    def way(direction: Array, curvature: Array) -> tuple[Array, Array]:
        chord = jnp.abs(curvature) * (paper.TRAVEL / (2 * paper.WHEELBASE))
        along = direction + jnp.sign(direction) * jnp.arcsin(jnp.minimum(1.0, chord))
        return -paper.TRAVEL * jnp.sin(along), paper.TRAVEL * jnp.cos(along)

    east, north = way(psi + theta, sine)
    xf, yf = xf + east, yf + north
    east, north = way(psi, tangent)
    xb, yb = xb + east, yb + north

    dx, dy = xf - xb, yf - yb
    distance = jnp.sqrt(dx * dx + dy * dy)
    gap = paper.WHEELBASE - distance
    repair = jnp.where(jnp.abs(gap) > paper.WHEELBASE_TOLERANCE, gap / distance, 0.0)
    xb, yb = xb - dx * repair, yb - dy * repair
    psi = jnp.arctan2(-dx, dy)
    return jnp.stack([theta, theta_dot, omega, omega_dot, omega_ddot, psi, xf, yf, xb, yb])


def observe(world: Array) -> Array:
    """What the rider sees, scaled."""
    theta, theta_dot, omega, omega_dot, _, _, xf, yf, xb, yb = world
    ux, uy, wx, wy = xf - xb, yf - yb, paper.GOAL[0] - xf, paper.GOAL[1] - yf
    angle = jnp.arctan2(ux * wy - uy * wx, ux * wx + uy * wy)
    return jnp.stack([omega, omega_dot, theta, theta_dot, angle]) / jnp.array(paper.STATE_SCALE)


def bicycle_start(uniform: Array) -> Array:
    """Upright at the origin, the heading from a uniform number."""
    psi = -jnp.pi + 2 * jnp.pi * uniform
    east, north = -jnp.sin(psi) * paper.WHEELBASE, jnp.cos(psi) * paper.WHEELBASE
    zero = jnp.zeros_like(psi)
    return jnp.stack([zero, zero, zero, zero, zero, psi, east, north, zero, zero])


def live(one: Population, uniform: Array, normal: Array) -> Population:
    """Ride for a tick and fit the model, for one learner, from uniforms and normals ``[2]``."""
    dtype = one.theta.dtype
    action = jnp.clip(one.theta @ one.observation + paper.EXPLORATION * normal, -1, 1)
    torque, displacement = (action * jnp.array(paper.ACTION_SCALE, dtype)).astype(jnp.float64)
    disturbance = (2 * uniform[0].astype(jnp.float64) - 1) * paper.DISTURBANCE
    world = bicycle_step(one.world, torque, displacement + disturbance)
    observation = observe(world).astype(dtype)

    moved = observation - one.observation
    moved = moved.at[-1].add(-paper.TURN * jnp.round(moved[-1] / paper.TURN))
    phi = jnp.concatenate([one.observation, action])
    residual = moved / paper.DT - one.weight @ phi
    weight = one.weight + paper.FIT_RATE * jnp.outer(jnp.sign(residual), phi)
    noise = one.noise
    if noise is not None:
        squared = paper.DT * jnp.outer(residual, residual)
        noise = noise + paper.NOISE_RATE * (squared - noise)
    ticks = one.ticks + 1
    return one._replace(
        world=world, observation=observation, weight=weight, noise=noise, ticks=ticks
    )


def improve(one: Population, gradient: Array, uniform: Array) -> Population:
    """Move the policy, and begin a new episode where one has ended, for one learner."""
    norm = jnp.sqrt((gradient * gradient).sum())
    theta = one.theta + paper.ALPHA / (paper.BETA + norm) * gradient

    world, observation = one.world, one.observation
    fell = ~(jnp.abs(world[2]) <= paper.FALLEN)
    east, north = world[6] - paper.GOAL[0], world[7] - paper.GOAL[1]
    arrived = east * east + north * north <= paper.GOAL_RADIUS**2
    ended = fell | arrived | (one.ticks >= paper.LIMIT_TICKS)
    fresh = bicycle_start(uniform[1].astype(jnp.float64))
    return one._replace(
        world=jnp.where(ended, fresh, world),
        observation=jnp.where(ended, observe(fresh).astype(observation.dtype), observation),
        theta=theta,
        ticks=jnp.where(ended, 0, one.ticks),
        episodes=one.episodes + ended,
        falls=one.falls + fell,
        rides=one.rides + (ended & ~fell),
    )


def _unroll_arguments(dtype: Any) -> tuple[Array, Array, Array]:
    """Cost, weights and dt."""
    cost = jnp.diag(jnp.array(paper.STATE_COST, dtype))
    weights = jnp.full(paper.HORIZON, paper.UNROLL_DT, dtype)
    return cost, weights, jnp.array(paper.UNROLL_DT, dtype)


def tick(one: Population, draws: tuple[Array, Array]) -> tuple[Population, Array]:
    """A tick of one learner, from its uniforms ``[2]`` and normals ``[2]``; and its value."""
    uniform, normal = draws
    one = live(one, uniform, normal)
    cost, weights, dt = _unroll_arguments(one.theta.dtype)
    known = (one.theta, one.weight, one.observation)
    if one.noise is None:
        value, gradient = jax.value_and_grad(mean_value)(*known, cost, weights, dt)
    else:
        both = jax.value_and_grad(covariance_value)
        value, gradient = both(*known, one.noise * dt, cost, weights, dt)
    return improve(one, gradient, uniform), value


@jax.jit
def ticks(population: Population, uniform: Array, normal: Array) -> tuple[Population, Array]:
    """K ticks of B learners, from uniforms and normals ``[K, B, 2]``; and values ``[K, B]``."""
    return lax.scan(jax.vmap(tick), population, (uniform, normal))


def _tick_by_hand(learners: Population, draws: tuple[Array, Array]) -> tuple[Population, Array]:
    """A tick of all learners, whose values and gradients go with the learners last."""
    uniform, normal = draws
    learners = jax.vmap(live)(learners, uniform, normal)
    cost, weights, dt = _unroll_arguments(learners.theta.dtype)
    known = [learners.weight, learners.theta, learners.observation]
    if learners.noise is not None:
        known.append(learners.noise * dt)
    function: Any = mean_adjoint_last if learners.noise is None else covariance_adjoint_last
    last = (jnp.moveaxis(array, 0, -1) for array in known)
    value, gradient = function(*last, cost, weights, dt)
    return jax.vmap(improve)(learners, jnp.moveaxis(gradient, -1, 0), uniform), value


@jax.jit
def ticks_by_hand(
    population: Population, uniform: Array, normal: Array
) -> tuple[Population, Array]:
    """``ticks`` with value and gradient by hand, the fastest way that was found in JAX."""
    return lax.scan(_tick_by_hand, population, (uniform, normal))


def population(numbers: dict[str, Any], dtype: Any) -> Population:
    """From arrays by name; the learner, not the world, in ``dtype``."""
    arrays: dict[str, Any] = {name: jnp.asarray(array) for name, array in numbers.items()}
    for name in ("observation", "weight", "theta", "noise"):
        arrays[name] = arrays[name].astype(dtype) if name in arrays else None
    return Population(**arrays)
