"""An episode as an animated WebP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from torch import Tensor

from edtorch.run.files import write_atomically
from sims.base import Pictured


def frame_times(states: int, slow: int, quick: int) -> list[int]:
    """Which states to show: the first ``slow`` one by one, then ``quick`` more evenly to the end.

    The beginning matters most: that is where most of the control happens.
    """
    if states <= slow + quick:
        return list(range(states))
    rest = np.linspace(slow, states - 1, quick).round().astype(int)
    return [*range(slow), *rest.tolist()]


def save_animation(
    sim: Pictured, states: Tensor, path: Path, *, slow: int = 100, quick: int = 80, fps: int = 15
) -> None:
    """Draw the episode whose states are ``[T, k]`` and write it to ``path``."""
    times = frame_times(states.shape[0], slow, quick)
    frames = [Image.fromarray(sim.frame(states[: t + 1])) for t in times]
    duration = [round(1000 / fps)] * len(frames)
    duration[-1] = 1500
    write_atomically(
        path,
        lambda partial: frames[0].save(
            partial,
            format="WEBP",
            save_all=True,
            append_images=frames[1:],
            duration=duration,
            loop=0,
            quality=80,
            method=2,
        ),
    )
