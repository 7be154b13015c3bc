"""Recorded transitions of any policy, in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Recorded:
    """N transitions, those of an episode one after the other; numpy arrays, physical units.

    state, next_state ``[N, n]``, action ``[N, m]`` (as applied), dt ``[N]`` in s; episode ``[N]``:
    different numbers for different episodes; terminated, truncated ``[N]``: whether the episode
    ends here, by itself or because somebody stopped; succeeded ``[N]``: whether it ends at the
    goal; seed ``[N]``: of the learner that it was recorded from, -1 if that is not known; valid
    ``[N]``: false where nothing is to be learned.
    """

    state: np.ndarray
    action: np.ndarray
    next_state: np.ndarray
    dt: np.ndarray
    episode: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    succeeded: np.ndarray
    seed: np.ndarray
    valid: np.ndarray

    def __len__(self) -> int:
        return len(self.dt)


def first_rows(episode: np.ndarray) -> np.ndarray:
    """Whether each row is the first of its episode; episode ``[N]``."""
    return np.diff(episode, prepend=episode[:1] - 1) != 0


def last_rows(episode: np.ndarray) -> np.ndarray:
    """Whether each row is the last of its episode; episode ``[N]``."""
    return np.append(np.diff(episode) != 0, True)


def shorter_way(difference: np.ndarray, period: np.ndarray) -> np.ndarray:
    """Differences ``[..., n]`` the short way round the circle, where a component has a period."""
    turns = np.where(period > 0, difference / np.where(period > 0, period, 1.0), 0.0)
    return difference - period * np.round(turns)
