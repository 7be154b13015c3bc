"""Poses that Cardea's episodes start from and are to reach: drawn at random, or given and checked.

A pose is the five joint angles of the arm, rad; a goal is given as the position of the wrist, m,
from the shoulder, in the body's frame, where the hand is to be level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sims.cardea.arm import HIGH, LOW, level_angles, level_poses
from sims.cardea.physics import Robot

Array = NDArray[np.float64]

STOPS = (2.4, 2.4, 2.7, 2.4, 2.8)
"""Where each joint stops, either way, rad (estimates)."""

_BOX = ((0.12, -0.55, -0.45), (0.55, 0.55, 0.45))
_REACH = 0.55
"""Wrist positions that goals are drawn from, m: within the box and this far from the shoulder."""

_TRIES = 10_000


def draw_start(robot: Robot, uniform: float, clearance: float) -> Sequence[float]:
    """A pose, uniform within ``LOW`` and ``HIGH``, with ``clearance``, m, all round; a function of
    ``uniform`` in [0, 1), which seeds a generator."""

    def pose(generator: np.random.Generator) -> Array:
        return generator.uniform(LOW, HIGH)

    return _draw(robot, uniform, clearance, pose)


def draw_goal(robot: Robot, uniform: float, clearance: float) -> Sequence[float]:
    """The pose of a goal: a wrist position, uniform where ``_BOX`` and ``_REACH`` allow, with a
    level hand; otherwise as ``draw_start``."""

    def pose(generator: np.random.Generator) -> Array | None:
        position = generator.uniform(*_BOX)
        return level_angles(position) if float(position @ position) <= _REACH**2 else None

    return _draw(robot, uniform, clearance, pose)


def goal_angles(robot: Robot, goal: Sequence[float], clearance: float) -> Sequence[float]:
    """The pose of a given goal; ValueError with about the nearest one that there is."""
    position = _numbers("goal", goal, 3)
    angles = level_angles(position)
    if angles is not None and robot.clear(angles.tolist(), clearance):
        return angles.tolist()
    poses, positions = level_poses(41)
    order = np.argsort(np.linalg.norm(positions - position, axis=1))
    near = (positions[k] for k in order if robot.clear(poses[k].tolist(), clearance))
    nearest = next(near, None)
    if nearest is None:
        raise _too_much(clearance)
    raise ValueError(
        f"goal={_text(position)} m: expected a wrist position, from the shoulder, that the arm"
        f" reaches with a level hand and {clearance} m clearance; about the nearest is"
        f" {_text(nearest)}"
    )


def check_start(robot: Robot, start: Sequence[float]) -> None:
    """Refuse a given start that is past a stop or in collision."""
    angles = _numbers("start", start, 5)
    if not bool((np.abs(angles) <= STOPS).all()):
        raise ValueError(f"start={_text(angles)} rad: expected angles within the stops, {STOPS}")
    if not robot.clear(angles.tolist(), 0.0):
        raise ValueError(
            f"start={_text(angles)} rad: expected a pose in which the arm touches nothing"
        )


def _draw(
    robot: Robot,
    uniform: float,
    clearance: float,
    pose: Callable[[np.random.Generator], Array | None],
) -> Sequence[float]:
    generator = np.random.default_rng(int(uniform * 2**53))
    for _ in range(_TRIES):
        angles = pose(generator)
        if angles is not None and robot.clear(angles.tolist(), clearance):
            return angles.tolist()
    raise _too_much(clearance)


def _too_much(clearance: float) -> ValueError:
    return ValueError(f"clearance={clearance} m: expected one that a pose of the arm can have")


def _numbers(name: str, given: Sequence[float], count: int) -> Array:
    try:
        numbers = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (count,) or not bool(np.isfinite(numbers).all()):
        raise ValueError(f"{name}={given}: expected {count} finite numbers")
    return numbers


def _text(numbers: Array) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in numbers) + ")"
