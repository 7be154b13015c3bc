"""What a bicycle may have of its own for a whole life: constants drawn at its beginning, and a
change of them at a certain age.  A new start after a fall leaves both as they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from sims.bicycle.physics import Physics

DRAWN = ("M_c", "M_p", "M_d", "h", "d_CM", "v", "l")
"""Constants that are drawn.  The centre of mass stays at its place along the wheelbase: ``c`` is
drawn with ``l``."""

CHANGING = ("v", "g", "d_CM", "c", "h", "M_c", "M_d", "M_p", "r")
"""Constants that may change in mid-ride: not the frame's own length, the handlebar's stop, and what
counts as a fall."""


def factors(uniforms: Tensor, spread: float) -> Tensor:
    """By what the constants ``DRAWN`` are multiplied, ``[7, *batch]``: uniform within ``spread`` of
    1 either way, from uniforms ``[7, *batch]``."""
    return 1 + spread * (2 * uniforms - 1)


def multiplied(physics: Physics, factors: Tensor) -> Physics:
    """``physics`` times ``factors`` ``[7, *batch]``: a bicycle of its own for each element."""
    drawn = {
        name: getattr(physics, name) * factor
        for name, factor in zip(DRAWN, factors.unbind(0), strict=True)
    }
    return replace(physics, c=physics.c * factors[DRAWN.index("l")], **drawn)


def changed(physics: Physics, change: Mapping[str, float], late: Tensor) -> Physics:
    """``physics`` with the constants that ``change`` names at its values where ``late``
    ``[*batch]``, bool."""
    shape = torch.zeros_like(late, dtype=torch.float64)
    after = {
        name: torch.where(late, shape + value, shape + getattr(physics, name))
        for name, value in change.items()
    }
    return replace(physics, **after)
