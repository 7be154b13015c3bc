"""Keeping every transition of a population, as ``transitions.npz`` wants them (docs/offline.md)."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch

from edtorch.run.rollout import Happened
from edtorch.run.scaled_sim import World
from sims.base import Outcome

_BLOCK = 512
"""Ticks that are written at once."""


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


def gathering_bytes(world: World, learners: int, ticks: float) -> float:
    """Memory that gathering the recording of so many ticks for ``transitions.npz`` takes, about:
    all numbers twice, by learner and together, and what else is said of each row."""
    return (2.0 * 8 * _width(world) + 56) * learners * ticks


def _width(world: World) -> int:
    return 2 * len(world.spec.state) + len(world.spec.action)


class Recorder:
    """Adds states, actions and how the episodes stood to a file, tick by tick.

    file: buffered, open for reading and writing; what it holds is gone on from.  It is a row of
    records, one for each tick: ``numbers`` ``[B, 2n + m]`` float64 (state, action, next state,
    scaled), ``episode`` ``[B]`` int32, ``outcome`` ``[B]`` int8 (-1: nothing happened).  Raises
    ValueError if it does not hold whole records, and OSError where it cannot be written to.
    """

    def __init__(self, world: World, learners: int, file: IO[bytes]) -> None:
        self._world = world
        self._file = file
        self._n = len(world.spec.state)
        self._record = np.dtype(
            [
                ("numbers", "<f8", (learners, _width(world))),
                ("episode", "<i4", (learners,)),
                ("outcome", "i1", (learners,)),
            ]
        )
        size = file.seek(0, os.SEEK_END)
        if size % self._record.itemsize:
            raise ValueError(
                f"recording: has {size} bytes, expected a multiple of {self._record.itemsize} for"
                f" {learners} learners of {world.spec.name}"
            )
        self._ticks = size // self._record.itemsize
        self._buffer = np.zeros(_BLOCK, self._record)
        self._waiting = 0

    @property
    def ticks(self) -> int:
        """How many the file holds; after ``flush``, all there were."""
        return self._ticks

    @property
    def size(self) -> int:
        """Bytes of the file that are records."""
        return self._ticks * self._record.itemsize

    def add(self, happened: Happened[Any]) -> None:
        """One more tick."""
        transition, here = happened.transition, self._buffer[self._waiting]
        numbers = here["numbers"]
        numbers[:, : self._n] = transition.state.numpy(force=True)
        numbers[:, self._n : -self._n] = transition.action.numpy(force=True)
        numbers[:, -self._n :] = transition.next_state.numpy(force=True)
        here["episode"][:] = happened.before.episodes.numpy(force=True)
        outcome = torch.where(transition.valid, happened.outcome, -1)
        here["outcome"][:] = outcome.numpy(force=True)
        self._waiting += 1
        if self._waiting == _BLOCK:
            self.flush()

    def flush(self) -> None:
        """Write what waits."""
        # At a place of its own, so that a write that failed can be repeated.
        self._file.seek(self.size)
        self._file.write(self._buffer[: self._waiting].tobytes())
        self._file.flush()
        self._ticks += self._waiting
        self._waiting = 0

    def flushed_to(self, path: Path) -> Path:
        """Have the file at ``path`` hold all; a copy where the ticks go to another file."""
        self.flush()
        if self._file.name != str(path):
            self._file.seek(0)
            with path.open("wb") as copy:
                shutil.copyfileobj(self._file, copy)
        return path

    def lived(self, row: int) -> Lived:
        """Of one learner."""
        records = self._records()
        outcome = np.array(records["outcome"][:, row], dtype=np.int64)
        stepped = outcome >= 0
        ticks, outcome = np.flatnonzero(stepped), outcome[stepped]
        # An episode that was broken off without a word goes on as another one.
        number = records["episode"][ticks, row]
        begins = (np.diff(ticks, prepend=ticks[:1]) > 1) | (np.diff(number, prepend=0) != 0)
        n, spec = self._n, self._world.spec
        state = [q.scale for q in spec.state]
        numbers = records["numbers"][ticks, row]
        numbers *= np.array([*state, *(q.scale for q in spec.action), *state])
        return Lived(
            state=numbers[:, :n],
            action=numbers[:, n:-n],
            next_state=numbers[:, -n:],
            episode=np.cumsum(begins),
            outcome=outcome,
        )

    def _records(self) -> np.ndarray:
        """All, as the file has them: only what is asked for is read."""
        self.flush()
        if not self._ticks:
            return np.zeros(0, self._record)
        return np.memmap(self._file, self._record, "r", shape=(self._ticks,))


def ended(outcome: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of these ``Outcome``s end an episode by itself, and which of them at its goal."""
    succeeded = outcome == int(Outcome.SUCCEEDED)
    return succeeded | (outcome == int(Outcome.FAILED)), succeeded
