"""A picture of one moment of a bicycle ride.

At the top the whole way as on a map, below it the bicycle from above with the last metres of its
path, on the right the rider from behind.  Drawn at twice the size and averaged down, so that slant
lines come out smooth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from sims.bicycle.displacement import displacement
from sims.bicycle.physics import RANDLOV, Physics

WIDTH, HEIGHT = 480, 270
_FINE = 2
"""Pixels drawn per pixel of the picture, each way."""

_PAPER, _PANEL, _LINE = (250, 248, 244), (255, 255, 255), (226, 222, 214)
_GRID, _INK, _SOFT = (238, 235, 229), (40, 44, 52), (128, 130, 136)
_PATH, _GOAL, _GOAL_FILL = (58, 110, 165), (214, 120, 44), (250, 228, 206)
_RIDER, _SKIN, _LIMIT = (58, 110, 165), (232, 190, 160), (206, 84, 74)

# Panels (left, top, right, bottom) in drawn pixels.
_MAP = (16, 16, 632, 184)
_NEAR = (16, 200, 632, 524)
_BEHIND = (648, 16, 944, 524)
_NEAR_SCALE = 32.0
"""Drawn pixels per metre around the bicycle."""
_FRONT_ON = 118.0
"""Drawn pixels per metre of the rider from behind."""

_MAP_POINTS, _NEAR_POINTS = 400, 160
_FALL = float(RANDLOV.omega_max)

Point = tuple[float, float]
Gates = Sequence[tuple[Point, Point]]


def frame(
    trail: Tensor,
    *,
    goal: Point = (1000.0, 0.0),
    goal_radius: float = 10.0,
    gates: Gates = (),
    physics: Physics = RANDLOV,
    dt: float = 0.01,
    side_force: Tensor | None = None,
) -> np.ndarray:
    """RGB picture, uint8 ``[270, 480, 3]``, of the last state of ``trail`` ``[T, k]``, T >= 1.

    ``trail``: the states of one ride so far, every one or every few, the first ten components of
    each being ``STATE`` of ``sims.bicycle.physics``; ``goal`` and ``goal_radius`` in m; ``gates``:
    both posts of each gate of a course of which the next one is at ``goal``.  Of steps of ``dt``
    seconds that are all there, where the rider hangs is worked out too, for the constants
    ``physics`` and the wind ``side_force`` ``[T]``; it is drawn five times as far as it is.
    """
    trail = trail.detach().cpu().double()
    wind = torch.zeros(len(trail)) if side_force is None else side_force.detach().cpu()
    while len(trail) > 0 and not bool(trail[-1].isfinite().all()):
        trail = trail[:-1]  # a ride that ran out of numbers is drawn as long as it had some
    if len(trail) == 0:
        raise ValueError("trail: no finite state in it; expected at least one")
    states = trail.numpy()
    image = _paper().copy()
    draw = ImageDraw.Draw(image)
    _draw_map(draw, states, goal, goal_radius, gates)
    image.paste(_near(states, goal, goal_radius, gates), _NEAR[:2])
    hang = _hang(trail, wind[: len(trail)], physics, dt)
    image.paste(_behind(states[-1], hang), _BEHIND[:2])
    _labels(draw, states[-1], goal, "goal" if not gates else "gate")
    return np.asarray(image.reduce(_FINE))


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


@lru_cache
def _paper() -> Image.Image:
    image = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _PAPER)
    draw = ImageDraw.Draw(image)
    for panel in (_MAP, _NEAR, _BEHIND):
        draw.rounded_rectangle(panel, 10, fill=_PANEL, outline=_LINE, width=2)
    return image


def _sampled(states: np.ndarray, count: int) -> np.ndarray:
    """About ``count`` of the states, the last one among them."""
    stride = max(1, len(states) // count)
    return np.concatenate([states[:-1:stride], states[-1:]])


def _disc(draw: ImageDraw.ImageDraw, centre: Point, radius: float, **colours: Any) -> None:
    x, y = centre
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), **colours)


def _stroke(
    draw: ImageDraw.ImageDraw, points: list[Point], colour: tuple[int, int, int], width: int
) -> None:
    """A line with round ends."""
    if len(points) > 1:
        draw.line(points, fill=colour, width=width, joint="curve")
    for point in (points[0], points[-1]):
        _disc(draw, point, width / 2 - 0.5, fill=colour)


def _draw_map(
    draw: ImageDraw.ImageDraw, states: np.ndarray, goal: Point, goal_radius: float, gates: Gates
) -> None:
    path = _sampled(states, _MAP_POINTS)[:, 6:8]
    posts = np.array([post for gate in gates for post in gate])
    edges = (np.subtract(goal, goal_radius), np.add(goal, goal_radius))
    if gates:
        edges = (posts.min(0), posts.max(0))
    low = np.minimum(np.minimum(path.min(0), path[0] - 20), edges[0])
    high = np.maximum(np.maximum(path.max(0), path[0] + 20), edges[1])
    left, top, right, bottom = _MAP[0] + 28, _MAP[1] + 58, _MAP[2] - 28, _MAP[3] - 20
    scale = min((right - left) / (high[0] - low[0]), (bottom - top) / (high[1] - low[1]))
    middle = (low + high) / 2

    def place(point: Sequence[float] | np.ndarray) -> Point:
        return (
            (left + right) / 2 + scale * (point[0] - middle[0]),
            (top + bottom) / 2 - scale * (point[1] - middle[1]),
        )

    start = place(path[0])
    if gates:
        for gate in gates:
            low_post, high_post = (place(post) for post in gate)
            colour = _GOAL if _is_next(gate, goal) else _SOFT
            draw.line((*low_post, *high_post), fill=colour, width=3)
            for post in (low_post, high_post):
                _disc(draw, post, 3.5, fill=colour)
    else:
        spot = place(goal)
        radius = max(scale * goal_radius, 9.0)
        length = math.hypot(spot[0] - start[0], spot[1] - start[1])
        for k in range(0, int(length), 14):
            share = k / length
            x, y = start[0] + share * (spot[0] - start[0]), start[1] + share * (spot[1] - start[1])
            _disc(draw, (x, y), 1.5, fill=_LINE)
        _disc(draw, spot, radius, fill=_GOAL_FILL, outline=_GOAL, width=3)
        _disc(draw, spot, 2.5, fill=_GOAL)
    _disc(draw, start, 5, fill=_SOFT)
    _stroke(draw, [place(point) for point in path], _PATH, 4)

    x, y = place(path[-1])
    psi = states[-1, 5]
    ahead, left_ = (-math.sin(psi), -math.cos(psi)), (-math.cos(psi), math.sin(psi))
    draw.polygon(
        [
            (x + 14 * ahead[0], y + 14 * ahead[1]),
            (x - 8 * ahead[0] + 8 * left_[0], y - 8 * ahead[1] + 8 * left_[1]),
            (x - 8 * ahead[0] - 8 * left_[0], y - 8 * ahead[1] - 8 * left_[1]),
        ],
        fill=_INK,
    )


def _is_next(gate: tuple[Point, Point], goal: Point) -> bool:
    middle = np.mean(gate, axis=0)
    return bool(np.allclose(middle, goal))


def _near(states: np.ndarray, goal: Point, goal_radius: float, gates: Gates) -> Image.Image:
    """The bicycle from above, in the middle of its panel."""
    width, height = _NEAR[2] - _NEAR[0], _NEAR[3] - _NEAR[1]
    image = _paper().crop(_NEAR)
    draw = ImageDraw.Draw(image)
    theta, psi, xf, yf, xb, yb = states[-1, [0, 5, 6, 7, 8, 9]]
    centre_x, centre_y = (xf + xb) / 2, (yf + yb) / 2

    def place(x: float, y: float) -> Point:
        return (
            width / 2 + _NEAR_SCALE * (x - centre_x),
            height / 2 - _NEAR_SCALE * (y - centre_y),
        )

    reach_x, reach_y = width / 2 / _NEAR_SCALE, height / 2 / _NEAR_SCALE
    for x in range(math.ceil((centre_x - reach_x) / 5) * 5, math.ceil(centre_x + reach_x), 5):
        draw.line((place(x, 0)[0], 2, place(x, 0)[0], height - 3), fill=_GRID, width=2)
    for y in range(math.ceil((centre_y - reach_y) / 5) * 5, math.ceil(centre_y + reach_y), 5):
        draw.line((2, place(0, y)[1], width - 3, place(0, y)[1]), fill=_GRID, width=2)

    for gate in gates:
        colour = _GOAL if _is_next(gate, goal) else _SOFT
        low, high = (place(*post) for post in gate)
        draw.line((*low, *high), fill=_GOAL_FILL if colour == _GOAL else _LINE, width=5)
        for post in (low, high):
            _disc(draw, post, 8, fill=colour)
    aside, beyond = abs(goal[0] - centre_x), abs(goal[1] - centre_y)
    if gates:
        in_sight = aside < reach_x and beyond < reach_y
    else:
        in_sight = math.hypot(aside, beyond) < goal_radius + reach_x + reach_y
    if in_sight and not gates:
        spot = place(*goal)
        _disc(draw, spot, goal_radius * _NEAR_SCALE, fill=_GOAL_FILL, outline=_GOAL, width=3)
        _disc(draw, spot, 6, fill=_GOAL)
    elif not in_sight:
        # An arrow to it, at the panel's edge.
        east, north = goal[0] - centre_x, centre_y - goal[1]
        share = min(
            (width / 2 - 34) / max(abs(east), 1e-9), (height / 2 - 34) / max(abs(north), 1e-9)
        )
        tip = (width / 2 + share * east, height / 2 + share * north)
        size = math.hypot(east, north)
        ux, uy = east / size, north / size
        draw.polygon(
            [
                (tip[0] + 18 * ux, tip[1] + 18 * uy),
                (tip[0] - 8 * ux + 11 * uy, tip[1] - 8 * uy - 11 * ux),
                (tip[0] - 8 * ux - 11 * uy, tip[1] - 8 * uy + 11 * ux),
            ],
            fill=_GOAL,
        )

    inside = np.hypot(states[:, 6] - centre_x, states[:, 7] - centre_y) < reach_x + reach_y
    # Only the last visit: the path may have been here before, and line segments must not jump.
    away = np.flatnonzero(~inside)
    recent = states[away[-1] + 1 :] if len(away) else states
    for column, colour, thick in ((8, (196, 212, 230), 5), (6, _PATH, 4)):
        path = _sampled(recent, _NEAR_POINTS)[:, column : column + 2]
        _stroke(draw, [place(x, y) for x, y in path], colour, thick)

    ahead = np.array([-math.sin(psi), math.cos(psi)])
    side = np.array([-math.cos(psi), -math.sin(psi)])
    turned = psi + theta
    steer = np.array([-math.sin(turned), math.cos(turned)])
    across = np.array([-math.cos(turned), -math.sin(turned)])
    front, back = np.array([xf, yf]), np.array([xb, yb])

    def line(a: np.ndarray, b: np.ndarray, colour: tuple[int, int, int], thick: int) -> None:
        _stroke(draw, [place(*a), place(*b)], colour, thick)

    line(back - 0.34 * ahead, back + 0.34 * ahead, _INK, 7)
    line(front - 0.34 * steer, front + 0.34 * steer, _INK, 7)
    line(back, front, _INK, 5)
    stem = front - 0.12 * ahead
    line(stem - 0.32 * across, stem + 0.32 * across, _INK, 5)
    seat = back + 0.42 * ahead
    for hand in (-1, 1):
        line(seat + 0.2 * hand * side, stem + 0.3 * hand * across, _SKIN, 6)
    line(seat - 0.2 * side, seat + 0.2 * side, _RIDER, 15)
    _disc(draw, place(*(seat + 0.06 * ahead)), 8, fill=_SKIN)

    right, bar = width - 30, 5 * _NEAR_SCALE
    draw.line((right - bar, height - 22, right, height - 22), fill=_SOFT, width=4)
    draw.text((right - bar / 2, height - 28), "5 m", _SOFT, _font(22), anchor="mb")
    draw.rounded_rectangle((0, 0, width, height), 10, outline=_LINE, width=2)
    return image


def _hang(trail: Tensor, wind: Tensor, physics: Physics, dt: float, steps: int = 25) -> float:
    """Mean displacement (m, to the left) over the last ``steps`` steps; 0 if states are left out
    of the trail, or there is but one."""
    recent = trail[-steps - 1 :]
    way = np.hypot(*np.diff(recent[:, 6:8].numpy(), axis=0).T)
    if len(way) == 0 or not np.allclose(way, float(physics.v) * dt, rtol=1e-3):
        return 0.0
    # A state holds the wind of the step to it.
    felt = wind[-steps - 1 :][1:]
    return float(displacement(recent, physics=physics, side_force=felt).mean().clamp(-0.04, 0.04))


def _behind(state: np.ndarray, displaced: float) -> Image.Image:
    """The rider from behind: what is on the left of the picture is on the rider's left."""
    width, height = _BEHIND[2] - _BEHIND[0], _BEHIND[3] - _BEHIND[1]
    image = _paper().crop(_BEHIND)
    draw = ImageDraw.Draw(image)
    theta, omega = float(state[0]), float(state[2])
    omega = max(-1.5, min(1.5, omega))
    foot_x, foot_y = width / 2, height - 130.0
    lean = (math.cos(omega), math.sin(omega))

    def place(aside: float, up: float) -> Point:
        """Metres to the left of the frame's plane and up along it."""
        left = aside * lean[0] + up * lean[1]
        high = up * lean[0] - aside * lean[1]
        return foot_x - _FRONT_ON * left, foot_y - _FRONT_ON * high

    def line(points: list[Point], colour: tuple[int, int, int], thick: int) -> None:
        _stroke(draw, [place(*point) for point in points], colour, thick)

    draw.line((24, foot_y + 4, width - 24, foot_y + 4), fill=_LINE, width=4)
    for side in (-1, 1):  # 12 degrees either way: beyond them, the bicycle has fallen
        limit = side * _FALL
        for k in range(0, 22, 2):
            a, b = 118 + 10 * k, 126 + 10 * k
            draw.line(
                (
                    foot_x - a * math.sin(limit),
                    foot_y - a * math.cos(limit),
                    foot_x - b * math.sin(limit),
                    foot_y - b * math.cos(limit),
                ),
                fill=(236, 190, 184),
                width=3,
            )

    hang = 5 * displaced
    # The front wheel, where it shows beside the back one, and the fork.
    swing = 0.34 * math.sin(max(-1.5, min(1.5, theta)))
    line([(swing, 0.12), (swing * 0.9, 0.5)], (120, 124, 132), 9)
    line([(0.0, 0.04), (0.0, 0.64)], _INK, 15)
    line([(0.0, 0.34), (0.0, 0.98)], (90, 94, 102), 9)
    for side in (-1, 1):  # legs, one up and one down
        pedal = 0.26 if side < 0 else 0.42
        line(
            [(0.6 * hang + side * 0.1, 1.0), (side * 0.19, 0.7), (side * 0.12, pedal)],
            _INK,
            17,
        )
    reach = 0.3 * math.sin(max(-1.5, min(1.5, theta)))
    for side in (-1, 1):  # handlebar: the hand that is drawn back is lower in the picture
        grip = (side * 0.33 * math.cos(theta), 1.12 - side * reach * 0.5)
        line([(0.0, 1.12), grip], _INK, 8)
        line([(hang + side * 0.22, 1.52), (hang * 0.6 + side * 0.36, 1.3), grip], _SKIN, 13)
    torso = [
        (0.55 * hang - 0.15, 0.98),
        (0.55 * hang + 0.15, 0.98),
        (hang + 0.23, 1.54),
        (hang - 0.23, 1.54),
    ]
    draw.polygon([place(*point) for point in torso], fill=_RIDER)
    line([torso[0], torso[1], torso[2], torso[3], torso[0]], _RIDER, 16)
    line([(0.5 * hang - 0.13, 0.97), (0.5 * hang + 0.13, 0.97)], _INK, 14)
    _disc(draw, place(1.08 * hang, 1.76), 18, fill=_SKIN)
    draw.pieslice(
        _around(place(1.08 * hang, 1.78), 20),
        180 - math.degrees(omega),
        360 - math.degrees(omega),
        fill=_GOAL,
    )
    return image


def _around(centre: Point, radius: float) -> tuple[float, float, float, float]:
    return centre[0] - radius, centre[1] - radius, centre[0] + radius, centre[1] + radius


def _labels(draw: ImageDraw.ImageDraw, state: np.ndarray, goal: Point, kind: str) -> None:
    theta, omega, xf, yf, xb, yb = (float(state[k]) for k in (0, 2, 6, 7, 8, 9))
    east, north = goal[0] - xf, goal[1] - yf
    ux, uy = xf - xb, yf - yb
    angle = math.degrees(math.atan2(ux * north - uy * east, ux * east + uy * north))
    left, top = _MAP[0] + 24, _MAP[1] + 14
    draw.text((left, top), f"{math.hypot(east, north):.0f} m to the {kind}", _INK, _font(28))
    where = "ahead" if abs(angle) < 0.5 else "on the left" if angle > 0 else "on the right"
    text = f"{abs(angle):.0f}° {where}" if where != "ahead" else "straight ahead"
    draw.text((_MAP[2] - 24, top), text, _GOAL, _font(28), anchor="ra")
    middle = (_BEHIND[0] + _BEHIND[2]) / 2
    fallen = abs(omega) > _FALL
    for row, (name, value) in enumerate((("lean", omega), ("handlebar", theta))):
        y = _BEHIND[3] - 92 + 36 * row
        colour = _LIMIT if fallen and row == 0 else _INK
        draw.text((middle - 8, y), name, _SOFT, _font(24), anchor="ra")
        draw.text((middle + 8, y), _side(value), colour, _font(24))


def _side(angle: float) -> str:
    degrees = math.degrees(angle)
    side = "" if abs(degrees) < 0.05 else " left" if degrees > 0 else " right"
    return f"{abs(degrees):.1f}°{side}"
