"""The animation of an episode: which of its states are shown, and that the file opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from edtorch.report.animation import frame_times, save_animation


class Counter:
    """Draws how many states it has been given as a grey value."""

    def __init__(self) -> None:
        self.seen: list[int] = []

    def frame(self, trail: Tensor) -> np.ndarray:
        self.seen.append(len(trail))
        return np.full((8, 8, 3), 10 * len(trail) % 256, dtype=np.uint8)


@pytest.mark.parametrize("states", [1, 7, 30])
def test_short_episodes_are_shown_whole(states: int) -> None:
    assert frame_times(states, 20, 10) == list(range(states))


@pytest.mark.parametrize("states", [31, 500, 100_001])
def test_long_ones_from_slow_to_quick(states: int) -> None:
    times = frame_times(states, 20, 10)
    assert times[:20] == list(range(20))
    assert times[-1] == states - 1
    assert len(times) == 30
    steps = np.diff(times)
    assert steps.min() >= 1
    assert np.ptp(steps[20:]) <= 1


def test_each_frame_sees_the_episode_so_far(tmp_path: Path) -> None:
    sim = Counter()
    save_animation(sim, torch.zeros(12, 3), tmp_path / "ride.webp", slow=4, quick=3, fps=10)
    assert sim.seen == [t + 1 for t in frame_times(12, 4, 3)]
    with Image.open(tmp_path / "ride.webp") as animation:
        assert getattr(animation, "n_frames", 1) == 7
        assert animation.size == (8, 8)
    assert [p.name for p in tmp_path.iterdir()] == ["ride.webp"]
