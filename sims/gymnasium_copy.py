"""One copy of a Gymnasium environment, and how to bring another one to where it is.

An environment cannot be saved.  One that repeats itself under its seed is brought back by the seed
of its episode and the actions since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sims.gymnasium_source import Env

Actions = Sequence[NDArray[np.floating]]
"""In order, each ``[m]`` as the environment got it."""


@dataclass
class Copy:
    """env: which only this object resets and steps; seed: of its last reset; actions: since."""

    env: Env
    seed: int = 0
    actions: list[NDArray[np.floating]] = field(default_factory=list)

    def reset(self, seed: int) -> Any:
        """What the environment's own returns."""
        self.seed, self.actions = seed, []
        return self.env.reset(seed=seed)

    def step(self, action: NDArray[np.floating]) -> Any:
        """What the environment's own returns."""
        # A copy of the action, since the environment may write into its own.
        self.actions.append(action.copy())
        return self.env.step(action)


def packed(episodes: Sequence[tuple[int, Actions]], size: int) -> dict[str, Tensor]:
    """Seeds and actions of episodes, each of ``size`` numbers: ``seeds``, ``steps`` ``[B]`` and all
    ``actions`` one after the other, ``[sum of steps, size]``."""
    actions = [action for _, taken in episodes for action in taken]
    # Float64 has the numbers of every smaller type.
    rows = np.array(actions, dtype=np.float64).reshape(-1, size)
    return {
        "seeds": torch.tensor([seed for seed, _ in episodes], dtype=torch.int64),
        "steps": torch.tensor([len(taken) for _, taken in episodes], dtype=torch.int64),
        "actions": torch.from_numpy(rows),
    }


def unpacked(memory: dict[str, Tensor], dtype: np.dtype[Any]) -> list[tuple[int, Actions]]:
    """What ``packed`` was given; dtype: of the actions."""
    rows = memory["actions"].numpy().astype(dtype)
    ends = memory["steps"].cumsum(0)[:-1].tolist()
    actions = [list(taken) for taken in np.split(rows, ends)]
    return list(zip(memory["seeds"].tolist(), actions, strict=True))
