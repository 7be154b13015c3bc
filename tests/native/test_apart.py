"""Learners in kernels whose worlds are not: the same digits, and one that acts in real time."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.model.fit import SquaredError
from edtorch.native.apart import Halves, RealTime
from edtorch.native.plan import NoKernel
from edtorch.run.episodes import Budget
from edtorch.run.random import learning_streams
from edtorch.run.recorder import Recorder
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from sims.base import Outcome, Quantity, Spec
from tests.native.kinds import LINEAR, farthest, lives, training_of
from tests.systems import bicycle_learner


class Pendulum:
    """theta'' = -g sin theta + u, pushed at random; episodes end with a fast turn, and now and then
    a step does not happen."""

    spec = Spec(
        name="pendulum",
        state=(
            Quantity("angle", "rad", math.pi, period=2 * math.pi),
            Quantity("rate", "rad/s", 3.0),
        ),
        action=(Quantity("torque", "N m", 2.0, -1.0, 1.0),),
        dt=0.05,
        time_limit=2.0,
        disturbance_dim=1,
        reset_dim=2,
        clip_action=True,
        headline="angle",
    )

    def initial(self, uniforms: Tensor) -> Tensor:
        """Angle, rate, and whether the last step was one."""
        start = 6 * uniforms[..., :2] - 3
        return torch.cat((start, torch.ones_like(start[..., :1])), dim=-1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        return torch.where(mask[..., None], self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        angle, rate, _ = state.unbind(-1)
        push = action[..., 0] + 3 * (uniforms[..., 0] - 0.5)
        rate = rate + 0.05 * (push - 9.81 * torch.sin(angle))
        happened = (uniforms[..., 0] < 0.9).to(torch.float64)
        return torch.stack((angle + 0.05 * rate, rate, happened), dim=-1)

    def observe(self, state: Tensor) -> Tensor:
        angle, rate, _ = state.unbind(-1)
        return torch.stack((torch.remainder(angle + math.pi, 2 * math.pi) - math.pi, rate), -1)

    def outcome(self, state: Tensor) -> Tensor:
        fast = state[..., 1].abs() > 6
        return torch.where(fast, int(Outcome.FAILED), int(Outcome.RUNNING))

    def stepped(self, state: Tensor) -> Tensor:
        return state[..., 2] > 0

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        return {}


def pendulums(seeds: list[int], recorder: Recorder | None = None) -> Training:
    world = World(Pendulum(), unwrap=0.5)
    learner = bicycle_learner(world, fit=SquaredError(0.5), horizon=10)
    return Training(learner, world, seeds, Budget(seconds=1000.0), 1, recorder=recorder)


def halved(training: Training, recorder: Recorder | None = None, lanes: int = 1) -> Training:
    streams = learning_streams(training.world, training.seeds)
    population = training.stage.population
    training.stage = Halves(training.tick, population, streams, recorder, lanes=lanes)
    return training


@pytest.mark.long
@pytest.mark.oracle
def test_learners_in_kernels_are_the_same_in_a_world_that_is_not(tmp_path: Path) -> None:
    seeds = list(range(6))
    files = [(tmp_path / name).open("w+b") for name in "ab"]
    kept = [Recorder(World(Pendulum()), len(seeds), file) for file in files]
    eager = pendulums(seeds, kept[0])
    apart = halved(pendulums(seeds, kept[1]), kept[1], lanes=4)
    for training in (eager, apart):
        training.advance(200)
    # From one stage to the other and on.
    apart.stage.replace(apart.stage.population)
    for training in (eager, apart):
        training.advance(150)
    assert lives(apart) == lives(eager) and len(eager.episodes) > 20
    worst = farthest(apart, eager)
    assert max(worst.values()) < 1e-9, worst
    ticks = eager.learners.tick
    assert bool((ticks < 350).all()) and bool((eager.learners.sound_ticks == ticks).all())
    for row in seeds:
        found, wanted = (own.lived(row) for own in reversed(kept))
        np.testing.assert_allclose(found.state, wanted.state, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.action, wanted.action, rtol=1e-9, atol=1e-9)
        assert (found.episode == wanted.episode).all()
    for file in files:
        file.close()


@pytest.mark.reference
def test_learners_of_a_gymnasium_environment() -> None:
    def training() -> Training:
        return training_of(
            "domain=gymnasium",
            "domain.env_id=InvertedPendulum-v5",
            "reward=quadratic",
            "+reward.state.state_1=1.0",
            "fit=least_squares",
            "transform=mean_only",
            "seeds=2",
            "train.seconds=1000",
            "train.successes=null",
        )

    eager, apart = training(), halved(training())
    for each in (eager, apart):
        each.advance(300)
    assert lives(apart) == lives(eager) and len(eager.episodes) > 5
    worst = farthest(apart, eager)
    assert max(worst.values()) < 1e-9, worst


@pytest.mark.oracle
def test_a_learner_in_real_time_is_the_learner_of_a_training() -> None:
    """In physical units, without being told what its world is."""
    training = pendulums([5])
    sim, world, tick = training.world.sim, training.world, training.tick
    rider = RealTime(training.learner, world, seed=5)
    streams = learning_streams(world, [5])
    state, before = world.initial(streams.at(0).uniform), 0
    rider.begin(sim.observe(state)[0].numpy())
    for clock in range(1, 601):
        training.advance(1)
        uniform = streams.at(clock).uniform
        action = torch.from_numpy(rider.act().copy()).unsqueeze(0)
        state = sim.step(state, action, uniform[:, :1])
        happened = bool(Pendulum().stepped(state))
        rider.learn(
            sim.observe(state)[0].tolist(), improve=tick.schedule.improves(clock), valid=happened
        )
        ended = world.outcome(state, torch.tensor([clock - before])) != 0
        if bool(ended):
            state, before = world.restart(state, ended, uniform), clock
            rider.begin(sim.observe(state)[0].numpy())
    for name in ("model", "policy"):
        found, wanted = (getattr(own, name)["weight"] for own in (rider.state, training.learners))
        assert torch.allclose(found, wanted, rtol=1e-9, atol=1e-9)
    assert rider.finite.all() and int(rider.state.tick) == int(training.learners.tick)
    before = rider.state
    rider.learn([math.nan, 0.0])
    assert rider.finite.tolist() == [False, False, False]
    assert torch.equal(rider.state.model["weight"], before.model["weight"])
    again = RealTime(training.learner, world, seed=5, state=before)
    assert torch.equal(again.state.policy["weight"], before.policy["weight"])
    with pytest.raises(ValueError, match=r"observation: has shape \(3,\), expected \(2,\)"):
        rider.begin([0.0, 0.0, 0.0])


class Net(torch.nn.Module):
    """A model without a matrix of weights."""

    def __init__(self, states: int, actions: int) -> None:
        super().__init__()
        self.inside = torch.nn.Linear(states + actions, states)

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        return torch.tanh(self.inside(torch.cat((state, action), dim=-1)))


def test_a_model_that_is_any_module_has_no_kernel() -> None:
    model = f"model={{_target_: {__name__}.Net}}"
    with pytest.raises(NoKernel, match="a model of the kind DerivativeModule"):
        halved(training_of(*LINEAR, model, "fit=gradient", "transform=mean_only"))
