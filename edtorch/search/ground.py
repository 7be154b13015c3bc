"""The force of the ground on a foot, learned: whether a gait would slip or lift off.

By Newton's law the force on a chain of links is the sum of mass times acceleration of its centre,
which is linear in sin q a, cos q a, sin q v^2 and cos q v^2 of the links' angles q, their rates v
and accelerations a; and weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.model.evidence import Evidence, ard
from edtorch.model.mechanism import Structure
from edtorch.types import Transition

PASSES, _TAIL = 3, 3.0
"""Regressions, and deviations at which a tick weighs half after the first of them: the tick of a
fall, in which motion stops, is none of free motion."""


@dataclass(frozen=True, eq=False)
class GroundForce:
    """weight ``[2, 4 J + 1]``: of the forces forward and up, in N, on the features of the angles
    ``hinge`` ``[J]`` (components); error ``[2]``: medians of what is left, N."""

    weight: np.ndarray
    hinge: np.ndarray
    error: np.ndarray


NO_GROUND = GroundForce(np.zeros((2, 1)), np.zeros(0, np.int64), np.zeros(2))
"""Where no force is read."""


def fit_ground(
    structure: Structure,
    transition: Transition,
    forces: tuple[int, int],
    unit: Tensor,
    evidence: Evidence = ard,
) -> GroundForce:
    """From transitions without an impact, whose readings at the end hold the force at the start.

    forces: the components, forward and up; unit ``[n]``: of the state.  Raises FitError for fewer
    rows than features.
    """
    angle = np.flatnonzero(structure.lift.angle & (structure.source >= 0))
    feature = ground_features(structure, transition, angle)[transition.valid]
    y = (transition.next_state * unit)[:, list(forces)][transition.valid].mT
    if len(feature) < feature.shape[1]:
        raise FitError(
            f"transitions: {len(feature)} without an impact, expected {feature.shape[1]} or more to"
            " learn the force of the ground"
        )
    share, allowed = torch.ones_like(y), torch.ones(len(y), feature.shape[1], dtype=torch.bool)
    found = evidence(feature, y, share, allowed)
    for _ in range(PASSES - 1):
        left = (y - found.weight @ feature.mT).abs()
        deviation = 1.483 * left.median(-1, keepdim=True).values
        share = 1 / (1 + (left / (_TAIL * deviation.clamp(min=1e-9))).square())
        found = evidence(feature, y, share, allowed)
    left = (y - found.weight @ feature.mT).abs()
    return GroundForce(found.weight.numpy(), angle, left.median(-1).values.numpy())


def ground_features(structure: Structure, transition: Transition, angle: np.ndarray) -> Tensor:
    """``[N, 4 J + 1]``, the accelerations being means over the ticks, in scaled units."""
    rate = structure.source[angle]
    lifted, at = structure.lift.of_state(transition.state), structure.lift.at[angle]
    v = transition.state[:, rate]
    a = (transition.next_state[:, rate] - v) / transition.dt
    s, c, square = lifted[:, at], lifted[:, at + 1], v.square()
    parts = torch.stack([s * a, c * a, s * square, c * square], dim=-1).flatten(1)
    return torch.cat([parts, torch.ones_like(parts[:, :1])], dim=-1)
