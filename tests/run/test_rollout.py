"""The one loop: against a loop written out, and what its listeners are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from edtorch.learner.learner import Actor
from edtorch.run.episodes import Budget
from edtorch.run.evaluation import Frozen, evaluate
from edtorch.run.random import Purpose, Streams, learning_streams, stream_key
from edtorch.run.recorder import Recorder
from edtorch.run.rollout import rollout
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tick
from edtorch.run.training import Training
from sims.base import Outcome
from sims.bicycle import Bicycle
from tests.systems import bicycle_learner, bicycle_training


def weights() -> tuple[Actor, dict[str, torch.Tensor]]:
    policy = bicycle_learner(World(Bicycle())).policy
    generator = torch.Generator().manual_seed(0)
    return policy, {"weight": 0.3 * torch.randn(3, 2, 5, generator=generator).double()}


def test_an_evaluation_is_the_loop_written_out() -> None:
    """Each episode alone, step by step, to the last digit."""
    policy, parameters = weights()
    sim = Bicycle(time_limit=0.8)
    world, found = World(sim), evaluate(policy, parameters, World(sim), [4, 5, 6], 2)
    outcomes = set()
    for row, seed in enumerate([4, 5, 6]):
        own = {"weight": parameters["weight"][row : row + 1]}
        for episode in found[row]:
            key = stream_key(seed, Purpose.EVALUATION, episode.number)
            streams = Streams([key], world.uniforms, 0)
            state = world.initial(streams.at(0).uniform)
            start, ticks, outcome = state, 0, torch.tensor([Outcome.RUNNING])
            while outcome.item() == Outcome.RUNNING:
                ticks += 1
                action = world.clip(policy.action(own, world.observe(state)))
                state = world.step(state, action, streams.at(ticks).uniform)
                outcome = world.outcome(state, torch.tensor([ticks]))
            seconds = torch.tensor([ticks * world.dt], dtype=torch.float64)
            measures = {k: float(v) for k, v in sim.measures(start, state, seconds).items()}
            assert (episode.seconds, int(episode.outcome)) == (ticks * world.dt, outcome.item())
            assert repr(episode.measures) == repr(measures)
            outcomes.add(episode.outcome)
    assert outcomes == {Outcome.FAILED, Outcome.TIMED_OUT}


def test_recorded_actions_are_those_applied(tmp_path: Path) -> None:
    """With what the learner knew before each tick, the same action comes out."""
    training = bicycle_training([5, 6], Budget(seconds=2.0))
    world, tick, streams = training.world, training.tick, learning_streams(training.world, [5, 6])
    with (tmp_path / "file").open("w+b") as file:
        recorder = Recorder(world, 2, file)
        other = Training(training.learner, world, [5, 6], training.budget, recorder=recorder)
        other.advance(60)
        lives = [recorder.lived(row) for row in range(2)]
    scale = np.array([q.scale for q in world.spec.action])
    population, ticks = training.stage.population, 0
    with torch.inference_mode():
        for happened in rollout(tick, population, streams.at, ticks=60):
            learners = population.learners
            wanted = training.learner.act(
                learners, happened.before.observation, streams.at(happened.clock).normal
            )
            wanted = world.clip(wanted).numpy() * scale
            recorded = np.stack([life.action[happened.clock - 1] for life in lives])
            np.testing.assert_array_equal(recorded, wanted)
            population, ticks = happened.population, happened.clock
    assert ticks == 60


def test_it_ends_with_the_last_episode_or_the_last_tick() -> None:
    policy, parameters = weights()
    world = World(Bicycle(time_limit=0.5))
    tick = Tick(Frozen(policy, parameters, None), world, most_episodes=2)
    streams = learning_streams(world, [1, 2, 3])
    first = tick.first({}, world.initial(streams.at(0).uniform))
    whole = list(rollout(tick, first, streams.at))
    assert not whole[-1].population.worlds.active.any()
    assert whole[-1].population.worlds.episodes.tolist() == [2, 2, 2]
    # In pieces it is the same.
    half = list(rollout(tick, first, streams.at, ticks=30))
    rest = list(rollout(tick, half[-1].population, streams.at, clock=30))
    assert [h.clock for h in half + rest] == [h.clock for h in whole]
    pairs = zip(half + rest, whole, strict=True)
    assert all(torch.equal(one.after.world, other.after.world) for one, other in pairs)
    ends = [h for h in whole if h.ended]
    assert all(bool(h.outcome.any()) == h.ended for h in whole) and len(ends) >= 2
