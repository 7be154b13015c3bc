"""Sims as Gymnasium environments, and Gymnasium environments as sims."""

from __future__ import annotations

import doctest
from typing import Literal

import gymnasium
import numpy as np
import pytest
import torch

import sims.gymnasium_env
from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from sims.base import Outcome
from sims.bicycle import Bicycle
from sims.from_gymnasium import GymnasiumSim
from sims.gymnasium_env import BicycleEnv, SimEnv
from tests.api_envs import Cart
from tests.systems import bicycle_learner


def unclipped_reward(before: np.ndarray, action: np.ndarray, after: np.ndarray) -> float:
    return float(action[0])


def test_registered_by_name_and_by_module() -> None:
    for name in ("edtorch/Bicycle-v0", "sims:edtorch/Bicycle-v0"):
        env = gymnasium.make(name, start_heading_low=0.5, start_heading_high=0.5).unwrapped
        assert isinstance(env, BicycleEnv)
        env.reset(seed=0)
        assert isinstance(env.sim, Bicycle) and env.sim.start_heading_low == 0.5


def test_same_seed_same_digits() -> None:
    def run(seed: int) -> list[float]:
        env = gymnasium.make("edtorch/Bicycle-v0")
        env.action_space.seed(seed)
        observation, _ = env.reset(seed=seed)
        numbers = list(observation)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            numbers += [*observation, reward]
            ended = terminated or truncated
        return [float(number) for number in numbers]

    assert run(5) == run(5)
    assert run(5) != run(6)


def test_reward_and_end_of_a_fall() -> None:
    env = BicycleEnv(fall_penalty=7.0)
    env.reset(seed=1)
    zero = np.zeros(2)
    ended, info = False, {}
    while not ended:
        assert info == {}
        observation, reward, ended, truncated, info = env.step(zero)
        cost = (observation[4] ** 2 + 10 * observation[0] ** 2) * 0.01
        assert reward == pytest.approx(-cost - 7 * ended, rel=1e-12) and not truncated
    assert info["outcome"] == "FAILED"
    assert np.isnan(info["measures"]["goal_time_s"]) and info["measures"]["path_length_m"] > 1
    with pytest.raises(RuntimeError, match="reset"):
        env.step(zero)


def test_truncates_at_the_time_limit() -> None:
    env = BicycleEnv(time_limit=0.3, noise=0.0)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2))[2:] for _ in range(30)]
    assert [truncated for _, truncated, _ in ends] == [False] * 29 + [True]
    assert not any(terminated for terminated, _, _ in ends)
    assert ends[-1][2]["outcome"] == "TIMED_OUT"


def test_arrives() -> None:
    near = BicycleEnv(goal_radius=1001.0)
    near.reset(seed=0)
    assert near.step(np.zeros(2))[4]["outcome"] == "SUCCEEDED"


def test_clips_only_where_the_sim_does() -> None:
    far = np.array([9.0, 0.0])
    for clip, wanted in ((True, 2.0), (False, 9.0)):
        env = SimEnv(Bicycle(clip_action=clip), unclipped_reward)
        env.reset(seed=0)
        assert env.step(far)[1] == wanted


def test_render() -> None:
    env = BicycleEnv(render_mode="rgb_array", noise=0.0)
    with pytest.raises(RuntimeError, match="reset"):
        env.render()
    env.reset(seed=0)
    first = env.render()
    for _ in range(2200):
        env.step(np.zeros(2))
    picture = env.render()
    assert isinstance(picture, np.ndarray) and isinstance(first, np.ndarray)
    assert picture.shape == (270, 480, 3) and not np.array_equal(first, picture)
    assert BicycleEnv().render() is None
    with pytest.raises(ValueError, match="render_mode='human'"):
        BicycleEnv(render_mode="human")


def test_refuses_the_impossible() -> None:
    with pytest.raises(ValueError, match="fall_penalty=-1"):
        BicycleEnv(fall_penalty=-1.0)
    with pytest.raises(ValueError, match="goal_radius=0"):
        gymnasium.make("edtorch/Bicycle-v0", goal_radius=0)
    with pytest.raises(TypeError, match="wheels"):
        gymnasium.make("edtorch/Bicycle-v0", wheels=3)


def test_the_example_in_the_docstring_runs() -> None:
    assert doctest.testmod(sims.gymnasium_env, verbose=False).failed == 0


def test_pendulum_as_a_sim() -> None:
    sim = GymnasiumSim("Pendulum-v1", headline="state_0", env_kwargs={"g": 9.81})
    spec = sim.spec
    assert (spec.dt, spec.time_limit, spec.reset_dim, spec.disturbance_dim) == (0.05, 10, 1, 0)
    assert [q.scale for q in spec.state] == [1, 1, 8] and spec.action[0].high == 2
    state = sim.initial(torch.tensor([[0.1], [0.7]], dtype=torch.float64))
    wanted = []
    for seed in (0.1, 0.7):
        env = gymnasium.make("Pendulum-v1", g=9.81)
        env.reset(seed=int(seed * 2**31))
        rewards = [env.step(np.array([0.5], np.float32)) for _ in range(200)]
        wanted.append((rewards[-1][0], sum(float(r[1]) for r in rewards)))
    start, nothing = state, torch.zeros(2, 0).double()
    for _ in range(200):
        assert sim.outcome(state).tolist() == [Outcome.RUNNING] * 2
        state = sim.step(state, torch.full((2, 1), 0.5).double(), nothing)
    assert sim.outcome(state).tolist() == [Outcome.TIMED_OUT] * 2
    assert sim.observe(state)[1].tolist() == wanted[1][0].tolist()
    returns = sim.measures(start, state, torch.full((2,), 10.0))["return"]
    assert float(returns[1]) == pytest.approx(wanted[1][1], rel=1e-12)
    assert torch.equal(sim.step(state, torch.ones(2, 1).double(), nothing), state)
    sim.close()


def test_termination_means_what_is_said() -> None:
    name, kwargs = "sims.gymnasium_env:edtorch/Bicycle-v0", {"goal_radius": 1001.0}
    meanings: tuple[tuple[Literal["failure", "success"], Outcome], ...] = (
        ("failure", Outcome.FAILED),
        ("success", Outcome.SUCCEEDED),
    )
    for termination, outcome in meanings:
        sim = GymnasiumSim(name, dt=0.01, time_limit=10, termination=termination, env_kwargs=kwargs)
        state = sim.initial(torch.zeros(1, 1).double())
        state = sim.step(state, torch.zeros(1, 2).double(), torch.zeros(1, 0).double())
        assert int(sim.outcome(state)) == outcome
        fresh = sim.restart(state, torch.tensor([True]), torch.zeros(1, 1).double())
        assert int(sim.outcome(fresh)) == Outcome.RUNNING


def test_an_environment_rests_once_its_learner_is_done() -> None:
    """Also where its episode was ended by a time limit that it does not know."""
    world = World(GymnasiumSim(env=Cart, dt=0.1, time_limit=3.0))
    learner = bicycle_learner(world, horizon=5)
    training = Training(learner, world, [0, 1, 2, 3], Budget(seconds=60.0, episodes=3))
    while not training.done:
        training.advance(1)
    lengths = [[e.seconds for e in training.episodes if e.row == row] for row in range(4)]
    assert [len(own) for own in lengths] == [3] * 4 and len({sum(own) for own in lengths}) > 1
    assert max(max(own) for own in lengths) == 3.0


def test_only_the_state_returned_last_goes_on() -> None:
    sim = GymnasiumSim("MountainCarContinuous-v0", dt=0.02)
    nothing, push = torch.zeros(1, 0).double(), torch.ones(1, 1).double()
    with pytest.raises(ValueError, match="initial first"):
        sim.step(torch.zeros(1, 5).double(), push, nothing)
    first = sim.initial(torch.rand(1, 1).double())
    sim.step(first, push, nothing)
    with pytest.raises(ValueError, match="returned last"):
        sim.step(first, push, nothing)
