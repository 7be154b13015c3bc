"""Keeping every transition of a population, as ``transitions.npz`` wants them (docs/offline.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.run.rollout import Happened
from edtorch.run.scaled_sim import World
from sims.base import Outcome

_BLOCK = 512
"""Ticks for which there is room at once."""


@dataclass(frozen=True)
class Lived:
    """What one learner has lived through, in order, in the sim's own units.

    state, next_state ``[T, n]``, action ``[T, m]`` (as applied); episode ``[T]``: from 0;
    outcome ``[T]``: an ``Outcome``, RUNNING but at the end of an episode.
    """

    state: np.ndarray
    action: np.ndarray
    next_state: np.ndarray
    episode: np.ndarray
    outcome: np.ndarray


def kept_bytes(world: World, learners: int, ticks: float) -> float:
    """Memory that the recording of so many ticks takes, about: kept, put together, written."""
    numbers = 2 * len(world.spec.state) + len(world.spec.action)
    return 3.0 * (8 * numbers + 6) * learners * ticks


class Recorder:
    """Keeps states, actions and how the episodes stood, tick by tick."""

    def __init__(self, world: World, learners: int) -> None:
        self._world = world
        self._size = learners
        self._n = len(world.spec.state)
        self._numbers: list[Tensor] = []
        self._episodes: list[Tensor] = []
        self._outcomes: list[Tensor] = []
        self._ticks = 0

    def add(self, happened: Happened[Any]) -> None:
        """One more tick."""
        row = self._ticks % _BLOCK
        if row == 0:
            width = 2 * self._n + len(self._world.spec.action)
            kind = torch.float64
            self._numbers.append(torch.empty(_BLOCK, self._size, width, dtype=kind))
            self._episodes.append(torch.empty(_BLOCK, self._size, dtype=torch.int32))
            self._outcomes.append(torch.empty(_BLOCK, self._size, dtype=torch.int8))
        transition, numbers = happened.transition, self._numbers[-1][row]
        numbers[:, : self._n] = transition.state
        numbers[:, self._n : -self._n] = transition.action
        numbers[:, -self._n :] = transition.next_state
        self._episodes[-1][row] = happened.before.episodes
        self._outcomes[-1][row] = torch.where(transition.valid, happened.outcome, -1)
        self._ticks += 1

    def lived(self, row: int) -> Lived:
        """Of one learner."""
        numbers = self._whole(self._numbers, row)
        outcome = self._whole(self._outcomes, row)
        stepped = outcome >= 0
        spec = self._world.spec
        state = np.array([q.scale for q in spec.state])
        numbers = numbers * np.concatenate([state, [q.scale for q in spec.action], state])
        ticks, outcome = np.flatnonzero(stepped), outcome[stepped].astype(np.int64)
        # An episode that was broken off without a word goes on as another one.
        number = self._whole(self._episodes, row)[stepped]
        begins = (np.diff(ticks, prepend=ticks[:1]) > 1) | (np.diff(number, prepend=0) != 0)
        n, numbers = self._n, numbers[stepped]
        return Lived(
            state=numbers[:, :n],
            action=numbers[:, n:-n],
            next_state=numbers[:, -n:],
            episode=np.cumsum(begins),
            outcome=outcome,
        )

    def _whole(self, blocks: list[Tensor], row: int) -> np.ndarray:
        if not blocks:
            width = 2 * self._n + len(self._world.spec.action)
            return np.zeros((0, width) if blocks is self._numbers else (0,))
        return torch.cat([block[:, row] for block in blocks])[: self._ticks].numpy()


def ended(outcome: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of these ``Outcome``s end an episode by itself, and which of them at its goal."""
    succeeded = outcome == int(Outcome.SUCCEEDED)
    return succeeded | (outcome == int(Outcome.FAILED)), succeeded
