"""Rows of a foreign file, and which of them are transitions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edtorch.run.recorded import Recorded, last_rows

NOT_FINITE = "a number that is not finite"


@dataclass(frozen=True)
class Candidates:
    """N rows, those of an episode one after the other, in the domain's units.

    state, next_state ``[N, n]``, action ``[N, m]``, dt ``[N]`` s, episode ``[N]``; terminated
    ``[N]``: whether the episode ends by itself in the row's next state; unusable: by reason, the
    rows ``[N]`` that are no transitions; broken ``[N]``: rows of an episode that do not end where
    the next row begins.
    """

    state: np.ndarray
    action: np.ndarray
    next_state: np.ndarray
    dt: np.ndarray
    episode: np.ndarray
    terminated: np.ndarray
    unusable: Mapping[str, np.ndarray]
    broken: np.ndarray


def kept(rows: Candidates) -> tuple[Recorded, dict[str, int]]:
    """The transitions, and how many rows were dropped for each reason, the first that applies.

    What lies before and after a dropped row become episodes of their own, cut off (truncated)
    where they do not terminate.
    """
    finite = np.isfinite(rows.dt)
    for array in (rows.state, rows.action, rows.next_state):
        finite &= np.isfinite(array).all(-1)
    use = np.ones(len(rows.dt), dtype=bool)
    dropped: dict[str, int] = {}
    for reason, unusable in {**rows.unusable, NOT_FINITE: ~finite}.items():
        count = int((unusable & use).sum())
        if count:
            dropped[reason] = count
        use &= ~unusable
    # A new episode after each row that is dropped, broken or the last of its own.
    ended = ~use | rows.broken | rows.terminated | last_rows(rows.episode)
    piece = (np.cumsum(ended) - ended)[use]
    _, episode = np.unique(piece, return_inverse=True)
    terminated = rows.terminated[use]
    count = len(episode)
    ends = last_rows(episode) if count else np.zeros(0, dtype=bool)
    return Recorded(
        state=rows.state[use],
        action=rows.action[use],
        next_state=rows.next_state[use],
        dt=rows.dt[use],
        episode=episode.astype(np.int64),
        terminated=terminated,
        truncated=ends & ~terminated,
        succeeded=np.zeros(count, dtype=bool),
        seed=np.full(count, -1, dtype=np.int64),
        valid=np.ones(count, dtype=bool),
    ), dropped


def followed(state: np.ndarray) -> np.ndarray:
    """The state ``[N, n]`` of the next row, NaN after the last."""
    return np.concatenate([state[1:], np.full((1, state.shape[1]), np.nan)])
