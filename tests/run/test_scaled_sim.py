"""A sim in the learner's units."""

from __future__ import annotations

import math

import pytest
import torch

from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.bicycle import Bicycle


def test_scales_clips_and_counts() -> None:
    world = World(Bicycle(start_heading_low=0.0, start_heading_high=0.0))
    state = world.initial(torch.zeros(1, 2).double())
    observation = world.observe(state)
    # The goal is 90 degrees to the right, but for the length of the bicycle.
    assert float(observation[0, 4]) == pytest.approx(-0.5, abs=1e-3)
    action = torch.tensor([[3.0, -0.5]], dtype=torch.float64)
    assert world.clip(action).tolist() == [[1.0, -0.5]]
    loose = World(Bicycle(clip_action=False))
    assert loose.clip(action) is action
    for each in (world, loose):
        wanted = each.physical(each.clip(action))[0]
        assert each.physical_array(action[0].numpy()).tolist() == wanted.tolist()
    assert world.period.tolist() == [0, 0, 0, 0, 2]
    assert world.limit_ticks == 100_000


def test_actions_reach_the_sim_in_its_own_units() -> None:
    sim = Bicycle()
    world = World(sim)
    state = world.initial(torch.full((2, 2), 0.3).double())
    scaled = torch.tensor([[0.5, -1.0], [0.0, 0.25]], dtype=torch.float64)
    uniform = torch.full((2, 2), 0.7).double()
    physical = scaled * torch.tensor([2.0, 0.02], dtype=torch.float64)
    assert torch.equal(
        world.step(state, scaled, uniform), sim.step(state, physical, uniform[:, :1])
    )


def test_the_time_limit_ends_an_episode_that_nothing_else_ended() -> None:
    world = World(Bicycle(time_limit=2.0))
    state = world.initial(torch.zeros(3, 2).double())
    fallen = state.clone()
    fallen[1, 2] = math.pi
    ticks = torch.tensor([199, 200, 200])
    assert world.outcome(fallen, ticks).tolist() == [
        Outcome.RUNNING,
        Outcome.FAILED,
        Outcome.TIMED_OUT,
    ]


def test_a_learner_in_single_precision_sees_single_precision() -> None:
    world = World(Bicycle(), torch.float32)
    state = world.initial(torch.zeros(1, 2))
    assert state.dtype == torch.float64
    assert world.observe(state).dtype == torch.float32
    assert world.step(state, torch.zeros(1, 2), torch.zeros(1, 2)).dtype == torch.float64


def test_angles_are_counted_on_until_they_are_too_far() -> None:
    # A heading that turns and turns, seen from a world that counts 1.5 rad beyond half a turn.
    world, wrapped = World(Bicycle(), unwrap=1.5), World(Bicycle())
    headings = torch.cat([torch.arange(0.0, 12.0, 0.1), torch.arange(12.0, -12.0, -0.1)]).double()
    states = torch.zeros(len(headings), 10, dtype=torch.float64)
    states[:, 5] = headings
    # The front tyre at the origin, the back tyre behind it: the goal is seen in direction pi/2.
    states[:, 8], states[:, 9] = headings.sin() * 1.11, -headings.cos() * 1.11
    seen = [world.observe(states[:1])]
    for state in states[1:]:
        seen.append(world.observe(state[None], seen[-1]))
    angle = math.pi * torch.cat(seen)[:, 4]
    plain = math.pi * wrapped.observe(states)[:, 4]
    # It is the same angle, but for whole turns, never too far, and jumps by whole turns only there.
    turns = (angle - plain) / (2 * math.pi)
    assert torch.allclose(turns, turns.round(), atol=1e-9)
    assert float(angle.abs().max()) <= math.pi + 1.5
    jumps = angle.diff().abs() > 0.2
    assert bool(jumps.any()) and bool((plain[1:][jumps].abs() < math.pi).all())
    assert float(angle[:-1][jumps].abs().min()) > math.pi + 1.5 - 0.11
    # On numpy alike, which policies act by.
    alone = None
    for state, wanted in zip(states, seen, strict=True):
        alone = world.counted_array(world.sim.observe(state[None])[0].numpy(), alone)
        assert alone.tolist() == wanted[0].tolist()
    # An episode begins wrapped.
    assert torch.equal(world.observe(states), wrapped.observe(states))


@pytest.mark.parametrize("unwrap", [-0.1, 3.2])
def test_refuses_to_count_on_for_ever(unwrap: float) -> None:
    with pytest.raises(ValueError, match=f"unwrap={unwrap}: expected a number in"):
        World(Bicycle(), unwrap=unwrap)
