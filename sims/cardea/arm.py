"""The geometry of Cardea's arm by plain trigonometry: where its wrist is, how to get it there.

Positions are those of the wrist's centre, in m from the shoulder, in the frame of the body: x
forward, y left, z up.  Angles, rad: shoulder yaw, shoulder pitch, elbow, wrist pitch, wrist roll; a
positive pitch lowers what follows.  ``sims.kinematics`` has the same for any chain, by
pytorch-kinematics; here it is for the start of an episode, which must cost next to nothing.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]

UPPER_ARM, FOREARM = 0.30, 0.28
"""Lengths from shoulder to elbow and from elbow to wrist, m."""

SHOULDER = (0.17, 0.0, 0.91)
"""Where the shoulder is in the body's frame, whose origin is the axle, m."""

LOW = (-1.2, -1.0, -2.2, -1.8, -1.5)
HIGH = (1.2, 1.3, 0.2, 1.8, 1.5)
"""Joint ranges for starts and goals, rad."""


def wrist(angles: Tensor) -> Tensor:
    """Position ``[*batch, 3]`` of the wrist; angles ``[*batch, 5]``."""
    yaw, pitch, elbow = angles[..., 0], angles[..., 1], angles[..., 2]
    out = UPPER_ARM * pitch.cos() + FOREARM * (pitch + elbow).cos()
    up = -UPPER_ARM * pitch.sin() - FOREARM * (pitch + elbow).sin()
    return torch.stack((out * yaw.cos(), out * yaw.sin(), up), -1)


def slant(angles: Tensor) -> Tensor:
    """Angle ``[*batch]`` in [0, pi] between the hand's upright and the body's; angles
    ``[*batch, 5]``.  0: the hand is level."""
    pitch, roll = angles[..., 1:4].sum(-1), angles[..., 4]
    upright = pitch.cos() * roll.cos()
    # Not the arc cosine, whose digits are gone where it matters, near 0.
    aside = (pitch.sin().square() + (pitch.cos() * roll.sin()).square()).sqrt()
    return torch.atan2(aside, upright)


def level_angles(position: Array) -> Array | None:
    """Joint angles ``[5]`` with the wrist at ``position`` ``[3]`` and the hand level, the elbow
    bent downwards; None where no angles within ``LOW`` and ``HIGH`` do it."""
    x, y, z = (float(value) for value in position)
    out = math.hypot(x, y)
    cosine = (out * out + z * z - UPPER_ARM**2 - FOREARM**2) / (2 * UPPER_ARM * FOREARM)
    if not abs(cosine) <= 1:
        return None
    # The elbow's range, -2.2 to 0.2 rad, leaves room for one of the two solutions.
    elbow = -math.acos(cosine)
    pitch = math.atan2(-z, out) - math.atan2(
        FOREARM * math.sin(elbow), UPPER_ARM + FOREARM * math.cos(elbow)
    )
    angles = np.array([math.atan2(y, x), pitch, elbow, -(pitch + elbow), 0.0])
    return angles if bool((angles >= LOW).all() and (angles <= HIGH).all()) else None


def level_poses(per_joint: int) -> tuple[Array, Array]:
    """A grid of level poses within the joint ranges: angles ``[N, 5]``, positions ``[N, 3]``;
    per_joint: points along each of yaw, shoulder pitch and elbow."""
    axes = [np.linspace(low, high, per_joint) for low, high in zip(LOW[:3], HIGH[:3], strict=True)]
    yaw, pitch, elbow = (axis.reshape(-1) for axis in np.meshgrid(*axes, indexing="ij"))
    angles = np.stack((yaw, pitch, elbow, -(pitch + elbow), np.zeros_like(yaw)), -1)
    angles = angles[(angles[:, 3] >= LOW[3]) & (angles[:, 3] <= HIGH[3])]
    return angles, wrist(torch.from_numpy(angles)).numpy()
