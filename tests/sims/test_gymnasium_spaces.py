"""Boxes: bounds that count as infinite, and the spaces of the registered environments."""

from __future__ import annotations

import math
import pickle
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces, wrappers
from gymnasium.utils.env_checker import check_env

import edtorch
from sims.from_gymnasium import GymnasiumSim
from sims.gymnasium_source import bounds
from tests.api_envs import Cart

REGISTERED = [spec.id for spec in gymnasium.registry.values() if spec.namespace == "edtorch"]


def _box(low: Any, high: Any, dtype: Any) -> spaces.Box:
    return spaces.Box(low, high, (2,), dtype)


@pytest.mark.parametrize(
    ("box", "wanted"),
    [
        (_box(-np.finfo(np.float32).max, np.finfo(np.float32).max, np.float32), (None, None)),
        (_box(-np.finfo(np.float64).max, np.finfo(np.float64).max, np.float64), (None, None)),
        (_box(-np.finfo(np.float16).max, np.finfo(np.float16).max, np.float16), (None, None)),
        (_box(-(2**63), 2**63 - 1, np.int64), (None, None)),
        (_box(0, 255, np.uint8), (0, 255)),
        (_box(-1e30, 1e30, np.float32), (None, None)),
        (_box(-1e30, 1e30, np.float64), (None, None)),
        (_box(-9e29, 9e29, np.float64), (-9e29, 9e29)),
        (_box(-3, 1e31, np.float64), (-3, None)),
        (_box(-1e31, 0.5, np.float32), (None, 0.5)),
        (_box(0, np.inf, np.float32), (0, None)),
        (_box(-1, 4, np.float32), (-1, 4)),
    ],
)
def test_bounds_from_1e30_on_and_the_largest_of_their_type_are_none(
    box: spaces.Box, wanted: tuple[float | None, float | None]
) -> None:
    low, high = (
        end if given is None else given
        for end, given in zip((-math.inf, math.inf), wanted, strict=True)
    )
    assert bounds(box).tolist() == [[low, high]] * 2


class Bounded(Cart):
    """A cart with other bounds."""

    def __init__(self, low: Any, high: Any, dtype: Any = np.float64, force: float = 2) -> None:
        super().__init__()
        self.observation_space = spaces.Box(low, high, (2,), dtype)
        self.action_space = spaces.Box(-force, force, (1,), np.float32)


def _of(**arguments: Any) -> Callable[[], Bounded]:
    return lambda: Bounded(**arguments)


LARGEST = float(np.finfo(np.float32).max)


@pytest.mark.parametrize(
    ("huge", "infinite"),
    [
        ({"low": -LARGEST, "high": LARGEST, "dtype": np.float32}, {"low": -np.inf, "high": np.inf}),
        ({"low": -3.0, "high": 1e30}, {"low": -3.0, "high": np.inf}),
    ],
)
def test_a_world_with_bounds_that_are_none_gives_the_digits_of_one_without(
    huge: dict[str, Any], infinite: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    infinite = {"dtype": huge.get("dtype", np.float64)} | infinite
    found = []
    for arguments in (huge, infinite):
        options = {"dt": 0.1, "seconds": 2, "time_limit": 1}
        run = edtorch.learn(_of(**arguments), **options, overrides=["eval.episodes=2"])
        said = capsys.readouterr().err
        line = "Bounded: the bounds of state_0, state_1 count as none: they are at least 1e30"
        assert said.count(line) == (arguments is huge)
        found.append([run.policies[0].predict(np.array(x)).tolist() for x in ((1, 0), (0.2, -1))])
        found[-1].append(run.episodes)
    assert found[0] == found[1]


def test_an_action_whose_bounds_are_none_needs_a_scale() -> None:
    with pytest.raises(ValueError, match="action_scale=None: expected a scale for action_0, which"):
        GymnasiumSim(env=_of(low=-1, high=1, force=LARGEST), dt=0.1)
    sim = GymnasiumSim(env=_of(low=-1, high=1, force=LARGEST), dt=0.1, action_scale=[2.0])
    assert (sim.spec.action[0].high, sim.spec.action[0].scale) == (math.inf, 2)


@pytest.mark.parametrize("name", REGISTERED)
def test_registered_environments_pass_the_checker(name: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped)
    # Physical units are meant, and some components have no physical bound.
    advice = ("normalized space", "minimum value is -infinity", "maximum value is infinity")
    said = [str(warning.message) for warning in caught]
    assert all(any(known in line for known in advice) for line in said)


@pytest.mark.parametrize("name", REGISTERED)
@pytest.mark.parametrize(
    "wrapped",
    [
        wrappers.FlattenObservation,
        wrappers.NormalizeObservation,
        wrappers.RecordEpisodeStatistics,
        wrappers.ClipAction,
        lambda env: wrappers.RescaleAction(env, np.float64(-1), np.float64(1)),
        lambda env: wrappers.TimeLimit(env, 2),
        lambda env: wrappers.FrameStackObservation(env, 3),
    ],
)
def test_registered_environments_can_be_wrapped(
    name: str, wrapped: Callable[[gymnasium.Env[Any, Any]], gymnasium.Env[Any, Any]]
) -> None:
    env = wrapped(gymnasium.make(name))
    env.observation_space.seed(1)
    env.action_space.seed(1)
    assert np.isfinite(env.observation_space.sample()).all()
    observation, _ = env.reset(seed=1)
    for _ in range(2):
        assert env.observation_space.contains(observation)
        observation = env.step(env.action_space.sample())[0]


@pytest.mark.parametrize("name", REGISTERED)
def test_registered_environments_learn_as_a_domain(name: str) -> None:
    sim = GymnasiumSim(name)
    env = gymnasium.make(name).unwrapped
    assert sim.spec.dt == env.get_wrapper_attr("sim").spec.dt
    limit = env.get_wrapper_attr("sim").spec.time_limit
    # A whole number of steps.
    assert sim.spec.time_limit == pytest.approx(limit, abs=sim.spec.dt / 2)
    assert sim.notes == []
    state = sim.initial(torch.tensor([[0.3]], dtype=torch.float64))
    size = len(sim.spec.action)
    state = sim.step(state, torch.zeros(1, size).double(), torch.zeros(1, 0).double())
    env.reset(seed=sim.env_seed(0.3))
    assert sim.observe(state)[0].tolist() == env.step(np.zeros(size))[0].tolist()


def test_the_handlebar_stays_within_its_bounds() -> None:
    env = gymnasium.make("edtorch/Bicycle-v0").unwrapped
    env.reset(seed=0)
    found = []
    for _ in range(60):
        observation, _, ended, *_ = env.step(np.array([2.0, 0.0]))
        assert env.observation_space.contains(observation)
        found.append(float(observation[2]))
        if ended:
            env.reset()
    assert max(found) == 1.3963


@pytest.mark.parametrize("name", REGISTERED)
def test_registered_environments_can_be_pickled_in_mid_episode(name: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array")
    env.action_space.seed(2)
    env.reset(seed=2)
    env.step(0.1 * env.action_space.sample())
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(3):
        # Small: the unicycle falls within four steps of large ones.
        action = 0.1 * env.action_space.sample()
        ours, theirs = env.step(action), copy.step(action)
        assert ours[0].tolist() == theirs[0].tolist() and ours[1:4] == theirs[1:4]


@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_registered_environments_run_in_processes() -> None:
    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.make("sims:edtorch/Bicycle-v0")

    envs = gymnasium.vector.AsyncVectorEnv([make, make], context="fork")
    observations, _ = envs.reset(seed=[3, 4])
    envs.close()
    alone = [make().reset(seed=seed)[0].tolist() for seed in (3, 4)]
    assert observations.tolist() == alone
