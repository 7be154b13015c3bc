"""The shortest time in which a bicycle can be at the goal.

The front tyre goes v per second, whatever the rider does, so the shortest time is the length of
the shortest path of the front tyre over v.  Its path bends by sin(theta) / l at most, theta being
the handlebar's angle that balances a steady turn at the largest lean that is no fall, the rider
leaning as far into the turn as he may (the disturbance averages out).  Such a path is, after
L. E. Dubins (American Journal of Mathematics 79, 1957), one arc of the tightest turn and then a
straight line, here one that meets the goal's disc at a right angle to its edge.

Lean and handlebar are taken to change in no time, which no rider can do: from a standing start the
front tyre may point up to theta away from the frame at once.  So rides take longer, by some tenths
of a second.  It is a bound for steady turns only: while a bicycle swings from one limit of its
lean to the other, its handlebar may for a moment be turned further, a gain of less than that.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sims.angles import atan2
from sims.bicycle.physics import RANDLOV, Physics


def steady_handlebar(
    *, displacement: float = 0.02, physics: Physics = RANDLOV, halvings: int = 60
) -> Tensor:
    """Handlebar's angle (rad, float64 of the shape of the constants) that holds the largest lean.

    The root theta of omega_ddot = 0 in ``sims.bicycle.physics.step`` with omega = omega_max,
    theta_dot = 0 and the rider ``displacement`` m into the turn, by bisection: the centrifugal
    moment grows with theta.
    """
    p = physics
    as_tensor = _float64
    l, behind, h = as_tensor(p.l), as_tensor(p.l) - p.c, as_tensor(p.h)  # noqa: E741
    moment = h * p.M * p.g * (as_tensor(p.omega_max) + (displacement / h).atan()).tan()
    low, high = torch.zeros_like(moment), as_tensor(p.theta_max).expand_as(moment)
    for _ in range(halvings):
        theta = (low + high) / 2
        tangent = theta.tan()
        centre = tangent / (tangent * tangent * behind * behind + l * l).sqrt()
        turning = p.M_d * p.r * (theta.sin() + tangent) / l + p.M * h * centre
        falls = turning * (p.v * p.v) < moment
        low, high = torch.where(falls, theta, low), torch.where(falls, high, theta)
    return (low + high) / 2


def shortest_time(
    start: Tensor,
    *,
    goal: tuple[float, float] = (1000.0, 0.0),
    goal_radius: float = 10.0,
    physics: Physics = RANDLOV,
    handlebar: Tensor | None = None,
) -> Tensor:
    """Seconds ``[*batch]`` that the way from ``start`` ``[*batch, 10]`` to the goal takes at least.

    356.0 s straight ahead from the origin, 360 s from behind.  Where the disc is so close that it
    is met before the arc ends, the time straight to its edge stands in: a bound too, if a loose
    one.  ``handlebar`` is that of ``steady_handlebar``, if it is known already.
    """
    length = shortest_length(
        start, goal=goal, goal_radius=goal_radius, physics=physics, handlebar=handlebar
    )
    return length / physics.v


def shortest_length(
    start: Tensor,
    *,
    goal: tuple[float, float] = (1000.0, 0.0),
    goal_radius: float = 10.0,
    physics: Physics = RANDLOV,
    handlebar: Tensor | None = None,
) -> Tensor:
    """Metres ``[*batch]`` of that way; arguments as those of ``shortest_time``."""
    components = start.movedim(-1, 0).contiguous()
    psi, x, y = components[5], components[6], components[7]
    if handlebar is None:
        handlebar = steady_handlebar(physics=physics)
    handlebar = handlebar.to(start)
    radius = physics.l / handlebar.sin()

    # The goal as the front tyre sees it: distance, and angle from the nearest direction it can
    # take at once.  Left and right are alike.
    east, north = goal[0] - x, goal[1] - y
    distance = (east * east + north * north).sqrt()
    bearing = atan2(-psi.cos() * east - psi.sin() * north, -psi.sin() * east + psi.cos() * north)
    bearing = (bearing.abs() - handlebar).clamp(min=0.0)

    # In coordinates with that direction as +x: the centre of the turn is at (0, radius).
    ahead, aside = distance * bearing.cos(), distance * bearing.sin() - radius
    straight = (ahead * ahead + aside * aside - radius * radius).clamp(min=0.0).sqrt()
    arc = atan2(aside, ahead) + atan2(radius.expand_as(straight), straight)
    # A goal behind needs more than half a circle; a tiny negative arc is rounding.
    arc = torch.where(arc < -1e-6, arc + 2 * math.pi, arc.clamp(min=0.0))
    turning = arc * radius + straight - goal_radius
    direct = (distance - goal_radius).clamp(min=0.0)
    return torch.where(straight >= goal_radius, turning, direct)


def _float64(value: float | Tensor) -> Tensor:
    return torch.as_tensor(value, dtype=torch.float64)
