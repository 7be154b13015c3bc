"""The tasks among Gymnasium's environments."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest

from sims.tasks.env import HeldTipEnv, PendulumSwingUpEnv, UnicycleEnv, WalkerEnv

TASKS = ["CartPoleSwingUp", "PendulumSwingUp", "Pendubot", "DoublePendulum", "CartDoublePendulum"]
TASKS += ["StopPendulum"]


@pytest.mark.parametrize("name", TASKS)
def test_an_episode(name: str) -> None:
    env = gymnasium.make(
        f"edtorch/{name}-v0", render_mode="rgb_array", time_limit=0.7, hold_from=0.4
    )
    inner = env.unwrapped
    assert isinstance(inner, HeldTipEnv)
    _, info = env.reset(seed=0)
    for k in range(1, inner.max_episode_steps + 1):
        _, reward, terminated, truncated, info = env.step(np.zeros(env.action_space.shape or ()))
        assert 0 <= float(reward) < 0.5 and not terminated
        assert truncated == (k == inner.max_episode_steps)
    assert info["outcome"] == "TIMED_OUT" and info["measures"]["tip_distance_m"] > 0.8
    assert np.asarray(env.render()).shape == (270, 480, 3)


def test_the_reward_is_pilcos() -> None:
    env = PendulumSwingUpEnv(noise=0.0, width=0.5)
    for angle, away in ((0.0, 0.0), (math.pi, 2.0), (math.pi / 3, 1.0)):
        reward = env.reward(np.zeros(2), np.zeros(1), np.array([angle, 3.0]))
        assert reward == pytest.approx(math.exp(-0.5 * (away / 0.5) ** 2))


def test_a_moving_target_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"amplitude=0.5: expected 0, an observation does not tell"
    ):
        gymnasium.make("edtorch/CartPoleSwingUp-v0", amplitude=0.5)


def test_a_unicycle_falls() -> None:
    env = gymnasium.make("edtorch/Unicycle-v0", render_mode="rgb_array")
    assert isinstance(env.unwrapped, UnicycleEnv)
    _, info = env.reset(seed=0)
    terminated, total, reward = False, 0.0, 1.0
    while not terminated:
        before = float(reward)
        _, reward, terminated, truncated, info = env.step(np.array([0.0, 5.0]))
        total += float(reward)
        assert 0 < float(reward) <= before + 0.01 and not truncated
    assert info["outcome"] == "FAILED" and info["measures"]["largest_tilt_rad"] > math.pi / 2
    assert 1 < total < 20
    assert np.asarray(env.render()).shape == (270, 480, 3)


def test_the_reward_of_a_unicycle_is_of_its_height() -> None:
    env, tilted = UnicycleEnv(), np.zeros(10)
    assert env.reward(np.zeros(10), np.zeros(2), tilted) == 1.0
    # On its side, its disc is sqrt(2) of its height, 1.035 m, away from upright.
    tilted[0] = math.pi / 2
    reward = env.reward(np.zeros(10), np.zeros(2), tilted)
    assert reward == pytest.approx(math.exp(-(1.035**2)))


def test_a_walker_slips() -> None:
    env = gymnasium.make("edtorch/Walker-v0", render_mode="rgb_array", friction=0.05)
    assert isinstance(env.unwrapped, WalkerEnv)
    observation, info = env.reset(seed=0)
    assert observation.shape == (13,) and not observation[10:].any()
    assert isinstance(env.action_space, gymnasium.spaces.Box)
    assert env.action_space.high.tolist() == [25.0, 150.0, 150.0, 25.0]
    _, _, terminated, truncated, info = env.step(np.zeros(4))
    assert terminated and not truncated and info["outcome"] == "FAILED"
    assert info["measures"]["steps"] == info["measures"]["distance_m"] == 0
    assert np.asarray(env.render()).shape == (270, 480, 3)


def test_the_reward_of_a_walker_is_how_far_its_hip_goes() -> None:
    env, place = WalkerEnv(foot=False), np.zeros(10)
    place[[0, 2]], place[[1, 3]] = (0.2, -0.1), (1.0, 2.0)
    ahead = place.copy()
    ahead[[0, 2]] += 0.01 * place[[1, 3]]

    def hip(seen: np.ndarray) -> float:
        return 0.4 * (math.sin(seen[0]) + math.sin(seen[2]))

    reward = env.reward(place, np.zeros(4), place)
    assert reward == pytest.approx(hip(ahead) - hip(place), rel=0.01)
