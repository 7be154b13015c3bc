"""The pendulum near upright."""

import numpy as np

from sims.tasks.pendulum import UprightPendulum


def test_starts_and_ends() -> None:
    env = UprightPendulum()
    for seed in range(20):
        observation, _ = env.reset(seed=seed)
        assert abs(np.arctan2(observation[1], observation[0])) <= 0.2
        assert abs(observation[2]) <= 0.5
    terminated = truncated = False
    observation = np.zeros(3)
    while not (terminated or truncated):
        observation, _, terminated, truncated, _ = env.step(np.array([2.0]))
    assert terminated and not truncated
    assert 0.6 < abs(np.arctan2(observation[1], observation[0])) < 1.2


def test_the_same_seed_gives_the_same_start() -> None:
    env = UprightPendulum()
    first, second = (env.reset(seed=3)[0] for _ in range(2))
    assert np.array_equal(first, second)
