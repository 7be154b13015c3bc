"""One copy of a Gymnasium environment, its row of the state, and how to bring another one there.

An environment cannot be saved.  One that repeats itself under its seed is brought back by the seed
of its episode and the actions since.
"""

from __future__ import annotations

import math
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


TERMINATED, TRUNCATED, SUCCESS, LOST, RETURN = -5, -4, -3, -2, -1
"""Places in a row ``[k + 5]`` of ``GymnasiumSim``, after an observation ``[k]``."""


@dataclass
class Copy:
    """env: which only this object resets and steps; size: k; most_steps: of an episode; seed: of
    its last reset; actions: since."""

    env: Env
    size: int
    most_steps: int
    seed: int = 0
    actions: list[NDArray[np.floating]] = field(default_factory=list)

    def reset(self, seed: int, dtype: torch.dtype) -> Tensor:
        """The row of a start; raises whatever the environment does."""
        self.seed, self.actions = seed, []
        started: Any = self.env.reset(seed=seed)
        if not (isinstance(started, tuple) and len(started) == 2):
            raise ValueError(f"it gave {type(started).__name__}, expected (observation, info)")
        row = torch.zeros(self.size + 5, dtype=dtype)
        row[:TERMINATED], row[SUCCESS] = self._checked(started[0]), -1.0
        return row

    def step(self, row: Tensor, action: NDArray[np.floating]) -> None:
        """Step from ``row``, in place; raises whatever the environment does."""
        # A copy of the action, since the environment may write into its own.
        self.actions.append(action.copy())
        observation, reward, terminated, truncated, info = self.env.step(action)
        row[:TERMINATED] = self._checked(observation)
        row[RETURN] += _finite_reward(reward)
        success = info.get("is_success")
        # Its learner may be done by then, and leave it in this state.
        late = len(self.actions) >= self.most_steps
        row[TERMINATED], row[TRUNCATED] = float(terminated), float(truncated or late)
        if success is not None:
            row[SUCCESS] = float(bool(success))

    def repeat(self, seed: int, actions: Actions, wanted: Tensor) -> str | None:
        """Go to the row ``wanted`` by these actions; why not, if that is not where they lead."""
        try:
            row = self.reset(seed, wanted.dtype)
            for action in actions:
                if is_over(row):
                    return "an episode ended early"
                self.step(row, action)
        except Exception as error:  # as in an episode
            return reason(error)
        same = row.numpy().tobytes() == wanted.numpy().tobytes()
        return None if same else "the same actions led elsewhere"

    def _checked(self, observation: Any) -> Tensor:
        read = torch.as_tensor(np.asarray(observation))
        if tuple(read.shape) != (self.size,):
            raise ValueError(
                f"an observation of shape {tuple(read.shape)}, expected {(self.size,)}"
            )
        if not bool(read.isfinite().all()):
            raise ValueError("an observation that is not finite")
        return read


def is_over(row: Tensor) -> bool:
    """Whether the episode in a row has ended or was lost."""
    return bool(row[TERMINATED] or row[TRUNCATED] or row[LOST])


def reason(error: Exception) -> str:
    """What an environment raised, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def _finite_reward(reward: Any) -> float:
    value = float(np.asarray(reward).item())
    if not math.isfinite(value):
        raise ValueError(f"a reward of {value}")
    return value


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
