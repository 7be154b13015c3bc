"""What is recorded is what happened."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import IO

import numpy as np
import pytest
import torch

from edtorch.run.episodes import Budget
from edtorch.run.recorder import Recorder, gathering_bytes
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.run.transitions_file import gathered, save_transitions
from sims.base import Outcome
from sims.bicycle import Bicycle
from tests.recorded import F, G, linear_learner, linear_world, lived
from tests.systems import bicycle_learner


def test_transitions_are_those_of_the_system() -> None:
    """s' = F s + G a holds in every row, so that state, action and next state belong together."""
    _, data = lived(linear_world(), linear_learner(), [3, 4], 600.0)
    assert len(data) == 1200
    moved = data.state @ np.array(F).T + data.action @ np.array(G).T
    np.testing.assert_allclose(data.next_state, moved, rtol=1e-12, atol=1e-14)
    assert data.action.std() > 0.9


def _training(seconds: float, file: IO[bytes]) -> tuple[Training, Recorder]:
    """Two learning bicycles."""
    world = World(Bicycle())
    recorder = Recorder(world, 2, file)
    budget = Budget(seconds=seconds)
    return Training(bicycle_learner(world), world, [5, 6], budget, recorder=recorder), recorder


@pytest.fixture
def file(tmp_path: Path) -> Iterator[IO[bytes]]:
    with (tmp_path / "recording").open("w+b") as file:
        yield file


def test_recording_changes_no_digit(file: IO[bytes]) -> None:
    one, _ = _training(6.0, file)
    other = Training(one.learner, one.world, one.seeds, one.budget)
    for training in (one, other):
        training.advance(600)
    assert torch.equal(one.learners.policy["weight"], other.learners.policy["weight"])
    assert torch.equal(one.worlds.world, other.worlds.world)


def test_episodes_of_the_recording_are_those_that_were_counted(file: IO[bytes]) -> None:
    """Of a learning bicycle: falls, lengths, and the actions within their bounds."""
    training, recorder = _training(8.0, file)
    world = training.world
    training.advance(800)
    for row in range(2):
        own = [e for e in training.episodes if e.row == row]
        life = recorder.lived(row)
        ends = np.flatnonzero(life.outcome)
        assert [int(life.outcome[end]) for end in ends] == [int(e.outcome) for e in own]
        lengths = np.diff(ends, prepend=-1) * world.dt
        np.testing.assert_allclose(lengths, [e.seconds for e in own])
        assert {Outcome.FAILED} == {e.outcome for e in own}
        assert life.episode[-1] == len(own) and life.episode[0] == 0
        bounds = np.array([q.high for q in world.spec.action])
        assert bool((np.abs(life.action) <= bounds * (1 + 1e-12)).all())
        # A fall is more lean than twelve degrees, in radians.
        assert bool((np.abs(life.next_state[ends, 0]) > np.pi / 15).all())


def test_a_file_is_gone_on_with(tmp_path: Path) -> None:
    """In two pieces, the end of the first cut off, the same bytes as in one."""
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    with whole.open("w+b") as file:
        training, recorder = _training(8.0, file)
        training.advance(800)
        assert 0 < recorder.ticks < 800
        recorder.flush()
        assert recorder.ticks == 800 and recorder.size == whole.stat().st_size
        lived = recorder.lived(1)
    with halves.open("w+b") as file:
        training, recorder = _training(8.0, file)
        training.advance(333)
        recorder.flush()
        kept = recorder.size
        state, episodes = training.state(), training.episodes
        training.advance(300)
        recorder.flush()
    with halves.open("r+b") as file:
        file.truncate(kept)
        training, recorder = _training(8.0, file)
        assert recorder.ticks == 333
        training.restore(state, episodes)
        training.advance(800 - 333)
        again = recorder.lived(1)
    assert halves.read_bytes() == whole.read_bytes()
    for name, wanted in asdict(lived).items():
        np.testing.assert_array_equal(getattr(again, name), wanted)


def test_half_a_record_is_refused(file: IO[bytes]) -> None:
    file.write(bytes(100))
    with pytest.raises(ValueError, match=r"has 100 bytes, expected a multiple of \d+ for 2"):
        _training(8.0, file)


def test_memory_is_told_beforehand(tmp_path: Path, file: IO[bytes]) -> None:
    """What gathering takes, and in proportion."""
    world, seeds, ticks = linear_world(), [3, 4, 10**6], 20_000
    record = 3 * (8 * (2 + 1 + 2) + 4 + 1)
    file.write(bytes(record * ticks))
    recorder = Recorder(world, len(seeds), file)
    tracemalloc.start()
    recorded = gathered([recorder.lived(row) for row in range(3)], seeds, world.dt)
    save_transitions(tmp_path / "file.npz", recorded, world.spec)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    needed = gathering_bytes(world, 3, ticks)
    assert len(recorded) == 3 * ticks and 0.9 * needed < taken < 1.1 * needed
    assert gathering_bytes(world, 6, ticks / 2) == needed
