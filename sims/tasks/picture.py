"""Pictures of the tasks: rods in a vertical plane, a walker, wires in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT = 480, 270
_FINE = 2
"""Pixels drawn per pixel of the picture, each way."""

Colour = tuple[int, int, int]

_PAPER, _GRID, _LINE = (250, 248, 244), (238, 235, 229), (190, 186, 178)
_INK, _SOFT, _PATH = (40, 44, 52), (128, 130, 136), (150, 180, 212)
_GOAL, _GOAL_FILL = (214, 120, 44), (250, 228, 206)
_RODS = ((58, 110, 165), (90, 94, 102))
_RECENT = 30
"""States whose tips are joined to a path."""


def rods(
    places: np.ndarray,
    *,
    target: np.ndarray,
    width: float,
    on_rail: bool,
    seconds: float,
    walls: Sequence[float] = (),
) -> np.ndarray:
    """RGB picture, uint8 ``[270, 480, 3]``, of the last of ``places`` ``[T, J, 2]``.

    ``places``: of the joints and the tip, m, right and up, the first joint at height 0; ``target``
    ``[2]``: of the tip, with a disc of radius ``width`` (m) about it; ``on_rail``: whether the
    first joint is that of a cart on a rail, which the picture then follows; ``seconds``: what the
    clock shows; ``walls``: angles from upright, anticlockwise, of stops about the first joint.
    """
    now = places[-1]
    reach = float(np.hypot(*np.diff(now, axis=0).T).sum())
    half = max(1.45 * reach if on_rail else 0.0, 1.05 * reach + width)
    scale = HEIGHT * _FINE / (2 * half)
    aside = half * WIDTH / HEIGHT - reach
    middle = float(np.clip(0.0, now[0, 0] - aside, now[0, 0] + aside))
    image = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _PAPER)
    draw = ImageDraw.Draw(image)

    def place(point: np.ndarray) -> tuple[float, float]:
        return (
            WIDTH * _FINE / 2 + scale * (float(point[0]) - middle),
            HEIGHT * _FINE / 2 - scale * float(point[1]),
        )

    def disc(point: np.ndarray, radius: float, colour: Colour) -> None:
        x, y = place(point)
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)

    disc(target, width * scale, _GOAL_FILL)
    disc(target, 5, _GOAL)
    if on_rail:
        across = half * WIDTH / HEIGHT
        for k in range(math.ceil(2 * (middle - across)), math.floor(2 * (middle + across)) + 1):
            x, _ = place(np.array([0.5 * k, 0.0]))
            draw.line((x, 0, x, HEIGHT * _FINE), fill=_LINE if k == 0 else _GRID, width=2)
        draw.line((0, HEIGHT * _FINE / 2, WIDTH * _FINE, HEIGHT * _FINE / 2), fill=_LINE, width=4)
    for angle in walls:
        outward = reach * np.array([-math.sin(angle), math.cos(angle)])
        draw.line((*place(now[0] + 0.3 * outward), *place(now[0] + outward)), fill=_LINE, width=8)
    path = [place(point) for point in places[-_RECENT:, -1]]
    if len(path) > 1:
        draw.line(path, fill=_PATH, width=4, joint="curve")
    if on_rail:
        x, y = place(now[0])
        draw.rounded_rectangle((x - 44, y - 20, x + 44, y + 20), 8, fill=_INK)
    for k, (a, b) in enumerate(pairwise(now)):
        colour = _RODS[k % 2]
        draw.line((*place(a), *place(b)), fill=colour, width=14)
        disc(a, 9, _SOFT)
        disc(b, 7, colour)
    return _finished(image, draw, seconds)


def walk(limbs: Sequence[np.ndarray], *, path: np.ndarray, seconds: float) -> np.ndarray:
    """RGB picture, uint8 ``[270, 480, 3]``, of ``limbs``, each a line ``[K, 2]`` (m, forward and
    up), about 1.5 m high on flat ground, seen from the side.

    The first is the farther leg.  ``path`` ``[T, 2]``: a line that ends where the picture follows;
    ``seconds``: what the clock shows.
    """
    scale = HEIGHT * _FINE / 1.75
    image = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _PAPER)
    draw = ImageDraw.Draw(image)
    middle, across = float(path[-1, 0]), WIDTH / HEIGHT * 1.75 / 2

    def place(point: np.ndarray) -> tuple[float, float]:
        return (
            WIDTH * _FINE / 2 + scale * (float(point[0]) - middle),
            0.9 * HEIGHT * _FINE - scale * float(point[1]),
        )

    for k in range(math.ceil(2 * (middle - across)), math.floor(2 * (middle + across)) + 1):
        x, y = place(np.array([0.5 * k, 0.0]))
        draw.line((x, y, x, y + 24), fill=_LINE, width=4 if k == 0 else 2)
    _, ground = place(np.zeros(2))
    draw.line((0, ground, WIDTH * _FINE, ground), fill=_LINE, width=4)
    if len(path) > 1:
        draw.line([place(point) for point in path[-_RECENT:]], fill=_PATH, width=4, joint="curve")
    for limb, colour in zip(limbs, (_SOFT, *_RODS), strict=True):
        for a, b in pairwise(limb):
            draw.line((*place(a), *place(b)), fill=colour, width=14)
        for point in limb:
            x, y = place(point)
            draw.ellipse((x - 7, y - 7, x + 7, y + 7), fill=colour)
    return _finished(image, draw, seconds)


def wires(
    curves: Sequence[np.ndarray], *, ground: np.ndarray, path: np.ndarray, seconds: float
) -> np.ndarray:
    """RGB picture, uint8 ``[270, 480, 3]``, of ``curves``, each ``[K, 3]`` (m, z up), about 1 m
    high, seen from above and behind.

    ``ground`` ``[3]``: the point of the ground that the picture follows; ``path`` ``[T, 3]``: a
    line on the ground; ``seconds``: what the clock shows.
    """
    scale = HEIGHT * _FINE / 1.9
    # The axes of the picture: seen from 35 degrees beside straight behind, 18 degrees above.
    beside, above = math.radians(35), math.radians(18)
    right = np.array([math.sin(beside), -math.cos(beside), 0.0])
    up = np.array(
        [
            math.sin(above) * math.cos(beside),
            math.sin(above) * math.sin(beside),
            math.cos(above),
        ]
    )
    image = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _PAPER)
    draw = ImageDraw.Draw(image)

    def line(points: np.ndarray, colour: Colour, width: int) -> None:
        seen = points - ground
        x = WIDTH * _FINE / 2 + scale * (seen @ right)
        y = 0.78 * HEIGHT * _FINE - scale * (seen @ up)
        draw.line(list(zip(x.tolist(), y.tolist(), strict=True)), colour, width, joint="curve")

    low, high = np.floor(ground[:2]) - 4, np.floor(ground[:2]) + 5
    for k in range(10):
        a, b = low + k
        line(np.array([[a, low[1], 0.0], [a, high[1], 0.0]]), _GRID, 2)
        line(np.array([[low[0], b, 0.0], [high[0], b, 0.0]]), _GRID, 2)
    if len(path) > 1:
        line(path, _PATH, 4)
    for k, curve in enumerate(curves):
        line(curve, (_INK, *_RODS)[k % 3], 6)
    return _finished(image, draw, seconds)


def _finished(image: Image.Image, draw: ImageDraw.ImageDraw, seconds: float) -> np.ndarray:
    """The picture at its size, with a clock."""
    font = ImageFont.load_default(26)
    draw.text((WIDTH * _FINE - 20, 14), f"{seconds:.2f} s", _INK, font, anchor="ra")
    return np.asarray(image.reduce(_FINE))
