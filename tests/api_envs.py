"""Small Gymnasium environments for the tests of the Python front door."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


class Cart(gymnasium.Env[Any, Any]):
    """A mass on a line that is pushed; ends beyond 3 m.  No spec, no time step of its own."""

    def __init__(self, steps: int = 40, trouble: str = "", first: int = 5) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = spaces.Box(-2.0, 2.0, (1,), np.float32)
        self._steps, self._trouble, self._first = steps, trouble, first
        self._count = 0
        self._state = np.zeros(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._state = self.np_random.uniform(-1, 1, 2)
        self._count = 0
        return self._state.copy(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert action.dtype == np.float32
        self._count += 1
        speed = self._state[1] + 0.1 * (float(action[0]) + 0.3 * self._state[0])
        self._state = np.array([self._state[0] + 0.1 * speed, speed])
        seen = self._state.copy()
        if self._trouble and self._count >= self._first:
            if self._trouble == "raise":
                raise RuntimeError("the cable broke")
            seen = {"nan": seen * np.nan, "shape": np.zeros(3)}[self._trouble]
        ended = bool(abs(self._state[0]) > 3)
        reward = float(1 - self._state[0] ** 2)
        return seen, reward, ended, self._count >= self._steps, {}
