"""Angles that come out with the same digits whatever the batch.

``torch.atan2`` computes the last few elements of a CPU tensor by another routine than the rest, so
that its result can depend, in the last bit, on how many elements there are.  ``torch.atan`` of a
contiguous tensor does not.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def atan2(y: Tensor, x: Tensor, radius: Tensor | None = None) -> Tensor:
    """The angle of the vector (x, y), in (-pi, pi], by the half-angle formula.

    For x >= 0 it is 2 atan(y / (radius + x)), a sum without cancellation; the other half-plane is
    that one mirrored.  Right to about one unit in the last place in all quadrants and on the axes
    (+pi for y = 0 or -0, x < 0; 0 for the null vector), with the right derivatives there too.
    ``radius`` is the length of the vector, if it is known already.  All tensors have one shape.
    """
    if radius is None:
        # The floor keeps the null vector, and the derivative there, finite.
        radius = (x * x + y * y).clamp(min=torch.finfo(x.dtype).tiny).sqrt()
    west = x < 0
    # Not x.abs(): its derivative at 0 is 0.
    angle = 2 * (y / (radius + torch.where(west, -x, x))).atan()
    mirrored = torch.where(y < 0, -math.pi - angle, math.pi - angle)
    return torch.where(west, mirrored, angle)
