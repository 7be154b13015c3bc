"""What is recorded is what happened."""

from __future__ import annotations

import numpy as np
import torch

from edtorch.run.episodes import Budget
from edtorch.run.recorder import Recorder, kept_bytes
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
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


def test_recording_changes_no_digit() -> None:
    world = World(Bicycle())
    learner = bicycle_learner(world)
    recorder = Recorder(world, 2)
    budget = Budget(seconds=6.0)
    one = Training(learner, world, [5, 6], budget, recorder=recorder)
    other = Training(learner, world, [5, 6], budget)
    for training in (one, other):
        training.advance(600)
    assert torch.equal(one.learners.policy["weight"], other.learners.policy["weight"])
    assert torch.equal(one.worlds.world, other.worlds.world)


def test_episodes_of_the_recording_are_those_that_were_counted() -> None:
    """Of a learning bicycle: falls, lengths, and the actions within their bounds."""
    world = World(Bicycle())
    learner = bicycle_learner(world)
    recorder = Recorder(world, 2)
    training = Training(learner, world, [5, 6], Budget(seconds=8.0), recorder=recorder)
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


def test_memory_is_told_beforehand() -> None:
    """At least what the numbers of the file take, and in proportion."""
    world = linear_world()
    needed = kept_bytes(world, 3, 1000)
    assert needed >= 3 * 1000 * 8 * (2 + 1 + 2)
    assert kept_bytes(world, 6, 500) == needed
