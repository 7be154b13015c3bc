"""Gymnasium's pendulum near upright, for methods that hold it there and do not swing it up."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

LEAN = 0.6
"""rad from upright beyond which an episode ends."""


class UprightPendulum(gymnasium.Wrapper[Any, Any, Any, Any]):
    """``Pendulum-v1`` that starts within 0.2 rad and 0.5 rad/s of upright and terminates beyond
    0.6 rad."""

    def __init__(self) -> None:
        super().__init__(gymnasium.make("Pendulum-v1"))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """A start near upright."""
        _, info = self.env.reset(seed=seed, options=options)
        inside: Any = self.env.unwrapped
        inside.state = inside.np_random.uniform([-0.2, -0.5], [0.2, 0.5])
        angle, rate = inside.state
        return np.array([np.cos(angle), np.sin(angle), rate], dtype=np.float32), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """As the pendulum does, and the end beyond 0.6 rad."""
        observation, reward, _, truncated, info = self.env.step(action)
        lean = abs(np.arctan2(observation[1], observation[0]))
        return observation, reward, bool(lean > LEAN), truncated, info
