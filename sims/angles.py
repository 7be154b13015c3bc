"""Angles that come out with the same digits whatever the batch.

``torch.atan2`` computes the last few elements of a CPU tensor by another routine than the rest, so
that its result can depend, in the last bit, on how many elements there are.  ``torch.atan`` of a
contiguous tensor does not.
"""

from __future__ import annotations

import math

from torch import Tensor

from sims.rows import TORCH, Function, Namespace


def atan2_over(xp: Namespace) -> tuple[Function, Function]:
    """The angle of the vector (x, y), in (-pi, pi], by the half-angle formula, over rows: a
    function of (y, x), and one of (y, x, radius) where the length of the vector is known.

    For x >= 0 it is 2 atan(y / (radius + x)), a sum without cancellation; the other half-plane is
    that one mirrored.  Right to about one unit in the last place in all quadrants and on the axes
    (+pi for y = 0 or -0, x < 0; 0 for the null vector), with the right derivatives there too.
    """

    @xp.jit
    def with_radius(y, x, radius):
        west = x < 0
        # Not abs(x): its derivative at 0 is 0.
        angle = 2 * xp.atan(y / (radius + xp.where(west, -x, x)))
        mirrored = xp.where(y < 0, -math.pi - angle, math.pi - angle)
        return xp.where(west, mirrored, angle)

    @xp.jit
    def angle(y, x):
        # The floor keeps the null vector, and the derivative there, finite.
        return with_radius(y, x, xp.sqrt(xp.maximum(x * x + y * y, xp.tiny(x))))

    return angle, with_radius


_ATAN2, _ = atan2_over(TORCH)


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """That angle for tensors of one shape."""
    return _ATAN2(y, x)
