"""A tick: what it leaves alone, and that it needs no other device than its population's."""

from __future__ import annotations

from dataclasses import replace as with_fields
from typing import Any, cast

import torch
from torch.utils import _pytree as pytree

from edtorch.run.episodes import Budget
from edtorch.run.random import Draw, learning_streams
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tick
from edtorch.types import replace
from edtorch.value.linear import LinearMeanOnly
from sims.base import Outcome
from sims.bicycle import Bicycle
from tests.populations import bicycle_training
from tests.systems import bicycle_learner


def test_learners_that_are_done_stay_as_they_are() -> None:
    training = bicycle_training([1, 2, 3], Budget(seconds=9.0))
    tick = training.tick
    training.advance(50)
    here = training.stage.population
    done = torch.tensor([False, True, False])
    here = replace(here, worlds=replace(here.worlds, active=~done))
    draw = learning_streams(training.world, training.seeds).at(51)
    there, _, outcome = tick.live(here, draw, 51, improve=True)
    there = tick.turn(there, outcome, draw, 51)
    pairs = zip(pytree.tree_leaves(here), pytree.tree_leaves(there), strict=True)
    assert all(torch.equal(one[1], other[1]) for one, other in pairs)
    assert not torch.equal(here.worlds.world[0], there.worlds.world[0])


def test_a_turn_counts_and_begins_anew() -> None:
    training = bicycle_training([1, 2, 3, 4], Budget(episodes=2))
    tick = training.tick
    here = training.stage.population
    here = replace(here, worlds=replace(here.worlds, episodes=torch.tensor([0, 1, 0, 0])))
    ends = [Outcome.FAILED, Outcome.FAILED, Outcome.SUCCEEDED, Outcome.RUNNING]
    draw = learning_streams(training.world, training.seeds).at(7)
    there = tick.turn(here, torch.tensor(ends), draw, 7).worlds
    assert there.episodes.tolist() == [1, 2, 1, 0]
    assert there.failures.tolist() == [1, 1, 0, 0] and there.successes.tolist() == [0, 0, 1, 0]
    assert there.active.tolist() == [True, False, True, True]
    assert there.begun.tolist() == [7, 0, 7, 0]
    fresh = (there.world != here.worlds.world).any(-1)
    assert fresh.tolist() == [True, False, True, False]
    assert torch.equal(there.start[fresh], there.world[fresh])


def test_a_tick_needs_no_other_device() -> None:
    # Tensors of the meta device have no numbers, and mix with no other device's: a tick that runs
    # on them neither asks for a number nor leaves a tensor behind.
    meta = torch.device("meta")
    world = World(Bicycle(), torch.float32, meta)
    learner = bicycle_learner(World(Bicycle(), torch.float32))
    assert isinstance(learner.value, LinearMeanOnly)
    learner = with_fields(
        learner,
        model=cast(Any, learner.model).to(meta),
        policy=cast(Any, learner.policy).to(meta),
        value=to_device(learner.value, meta),
    )
    tick = Tick(learner, world, most_successes=1)
    draw = Draw(torch.empty(8, world.uniforms, device=meta), torch.empty(8, 2, device=meta))
    here = tick.first(learner.initial(range(8)), world.initial(draw.uniform))
    clock = torch.empty((), dtype=torch.int64, device=meta)
    there, _, outcome = tick.live(here, draw, clock, improve=True)
    there = tick.turn(there, outcome, draw, clock)
    leaves = pytree.tree_leaves(there)
    assert all(leaf.device == meta for leaf in leaves)
    shapes = [(leaf.shape, leaf.dtype) for leaf in pytree.tree_leaves(here)]
    assert shapes == [(leaf.shape, leaf.dtype) for leaf in leaves]


def to_device(value: LinearMeanOnly, device: torch.device) -> LinearMeanOnly:
    """The path with its costs and weights elsewhere."""
    return with_fields(
        value, state_cost=value.state_cost.to(device), weights=value.weights.to(device)
    )
