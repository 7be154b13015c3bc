"""Returns and successes: sums made by hand, and which evidence decides."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import evaluate, starts
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.scaled_sim import World
from edtorch.run.success import OPEN, SuccessRule, settled
from sims.base import Outcome, Quantity, Spec
from sims.from_gymnasium import GymnasiumSim
from sims.linear import LinearSystem
from sims.sensing import Sensed
from tests.recorded import F, G, Q, R, linear_learner, lived
from tests.systems import f64

REWARD = QuadraticReward(Q, R)
DT = 0.5


def rewarded_world() -> World:
    """Episodes of eight steps of half a second."""
    sim = LinearSystem(F, G, noise=0.1, dt=DT, time_limit=4.0)
    return World(sim, reward=REWARD)


def test_return_of_training_is_the_sum_over_time() -> None:
    """Of every episode of two learners, from what was recorded of each tick."""
    training, data = lived(rewarded_world(), linear_learner(), [3, 4], 50.0)
    cost = ((data.state @ Q.numpy()) * data.state).sum(1)
    cost = cost + ((data.action @ R.numpy()) * data.action).sum(1)
    for row, seed in enumerate([3, 4]):
        own = [e for e in training.episodes if e.row == row]
        mine = data.seed == seed
        totals = [
            -DT * cost[mine & (data.episode == k)].sum() for k in np.unique(data.episode[mine])
        ]
        assert len(own) > 10
        np.testing.assert_allclose([e.total_reward for e in own], totals[: len(own)], rtol=1e-12)


def test_return_of_an_evaluation_is_the_sum_over_time() -> None:
    world, weight = rewarded_world(), f64([[[-0.1, 0.4]], [[0.3, -0.5]]])
    policy, states = LinearPolicy(2, 1, Identity(2)), []
    found = evaluate(policy, {"weight": weight}, world, [5, 6], 3, watch=states.append)
    keys = [stream_key(s, Purpose.EVALUATION, e) for s in (5, 6) for e in range(3)]
    start = starts(world, [5, 6], 3, Streams(keys, world.uniforms, 0).at(0).uniform)
    path = torch.stack([start, *states[:-1]])
    action = (weight.repeat_interleave(3, 0).squeeze(1) * path).sum(-1, keepdim=True)
    total = DT * REWARD(path, action).sum(0)
    np.testing.assert_allclose([e.total_reward for own in found for e in own], total, rtol=1e-12)


def test_without_a_reward_there_is_no_return() -> None:
    training, _ = lived(World(LinearSystem(F, G, time_limit=8.0)), linear_learner(), [3], 20.0)
    assert all(np.isnan(e.total_reward) for e in training.episodes)


class Toy(gymnasium.Env[np.ndarray, np.ndarray]):
    """Pays the number of the step; may end after ``ends`` steps, and may say that it succeeded."""

    dt = 1.0

    def __init__(self, ends: int = 0, success: bool | None = None) -> None:
        self.observation_space = spaces.Box(-1.0, 1.0, (2,))
        self.action_space = spaces.Box(-1.0, 1.0, (1,))
        self.ends, self.success = ends, success

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        self.steps = 0
        return np.zeros(2, np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        info = {} if self.success is None else {"is_success": self.success}
        return np.zeros(2, np.float32), float(self.steps), self.steps == self.ends, False, info


for name, threshold in (("Toy-v0", None), ("ToyOfFifteen-v0", 15.0)):
    gymnasium.register(name, f"{__name__}:Toy", max_episode_steps=5, reward_threshold=threshold)


def toy(env_id: str = "Toy-v0", **kwargs: Any) -> GymnasiumSim:
    return GymnasiumSim(env_id, env_kwargs=kwargs)


def tried(sim: Any, least: float | None = None) -> Episode:
    """An episode of a policy that does nothing."""
    n = len(sim.spec.state)
    policy = LinearPolicy(n, 1, Identity(n))
    zero = {"weight": torch.zeros(1, 1, n, dtype=torch.float64)}
    ((episode,),) = evaluate(policy, zero, World(sim, reward=REWARD, success_return=least), [0], 1)
    return episode


S, FAILED, LATE = Outcome.SUCCEEDED, Outcome.FAILED, Outcome.TIMED_OUT


@pytest.mark.parametrize(
    ("sim", "least", "outcome", "success"),
    [
        # Nothing is known.
        (toy(), None, LATE, None),
        # The environment says so, whatever the return is and however it ended.
        (toy(success=True), 99.0, S, True),
        (toy(success=False), 1.0, LATE, False),
        (toy(success=True, ends=3), 99.0, S, True),
        (toy(success=False, ends=3), 1.0, FAILED, False),
        # 1 + 2 + 3 + 4 + 5 = 15, and 1 + 2 + 3 = 6.
        (toy("ToyOfFifteen-v0"), None, S, True),
        (toy("ToyOfFifteen-v0", ends=3), None, FAILED, False),
        (toy("ToyOfFifteen-v0"), 15.5, LATE, False),
        (toy("ToyOfFifteen-v0", ends=3), 6.0, S, True),
        # It can end, so to last is the task.
        (toy(ends=3), None, FAILED, False),
        # Seen through sensors it is the same environment.
        (Sensed(toy("ToyOfFifteen-v0"), {}, 1), None, S, True),
        (Sensed(toy(success=False), {}, 1), 1.0, LATE, False),
    ],
)
def test_the_order_in_which_success_is_decided(
    sim: Any, least: float | None, outcome: Outcome, success: bool | None
) -> None:
    episode = tried(sim, least)
    assert (episode.outcome, episode.success) == (outcome, success)
    assert episode.total_reward == (6.0 if outcome is FAILED or episode.seconds == 3 else 15.0)


def test_what_is_open_is_decided_by_the_run() -> None:
    def ended(outcome: Outcome, success: bool | None) -> Episode:
        return Episode(0, 0, 0.0, 1.0, outcome, {}, success=success)

    late, fell, there = ended(LATE, None), ended(FAILED, False), ended(S, True)
    assert [e.success for e in settled([late, late], [late, late])] == [None, None]
    assert [e.success for e in settled([late, fell], [late, fell])] == [True, False]
    assert [e.success for e in settled([late, late], [fell, late])] == [True, True]
    assert [e.success for e in settled([late, there], [fell, late, there])] == [False, True]


def test_the_rule_of_a_domain() -> None:
    spec = Spec("d", (Quantity("x", "1"),), (Quantity("a", "1"),), 1.0, 9.0, 0, 0, False, "x")
    assert SuccessRule.of(spec) == SuccessRule(None, None)
    assert SuccessRule.of(spec, 3.0) == SuccessRule(3.0, False)
    sim, state = LinearSystem([[1.0]], [[1.0]]), torch.zeros(3, 1).double()
    ends = torch.tensor([LATE, S, FAILED])
    assert SuccessRule().success(sim, state, ends).tolist() == [OPEN, 1, 0]
    assert SuccessRule(None, True).success(sim, state, ends).tolist() == [1, 1, 0]
    counted = SuccessRule(2.0, False).outcome(sim, state, ends, f64([2.0, 0.0, 1.0]))
    assert counted.tolist() == [S, S, FAILED]


def test_returns_of_an_environment_while_learning() -> None:
    """Two learners, episodes begun anew: 15 each, and counted as what the rule says they are."""
    counts = {}
    for env_id in ("Toy-v0", "ToyOfFifteen-v0"):
        training, _ = lived(World(toy(env_id), reward=REWARD), linear_learner(), [1, 2], 20.0)
        assert [e.total_reward for e in training.episodes] == [15.0] * 8
        assert {e.success for e in training.episodes} == {None if env_id == "Toy-v0" else True}
        counts[env_id] = training.worlds.successes.tolist()
    assert counts["ToyOfFifteen-v0"] == [4, 4]
    short, _ = lived(World(toy("ToyOfFifteen-v0", ends=3)), linear_learner(), [1, 2], 12.0)
    assert [e.total_reward for e in short.episodes] == [6.0] * 8
    assert (short.worlds.failures.tolist(), short.worlds.successes.tolist()) == ([4, 4], [0, 0])


class Faulty(LinearSystem):
    """Loses each episode in which the first component becomes negative, at once."""

    def outcome(self, state: Tensor) -> Tensor:
        return torch.where(self.lost(state), int(FAILED), super().outcome(state))

    def lost(self, state: Tensor) -> Tensor:
        return state[..., 0] < 0


def test_lost_episodes_are_counted_and_left_out() -> None:
    sim = Faulty(F, G, noise=0.1, time_limit=3.0)
    training, data = lived(World(sim, reward=REWARD), linear_learner(), [1, 2], 40.0)
    for row, seed in enumerate([1, 2]):
        own = [e for e in training.episodes if e.row == row]
        bad = (data.next_state[data.seed == seed, 0] < 0).sum()
        assert training.lost_episodes[row] == bad > 3
        assert int(training.worlds.episodes[row]) == len(own) + bad
    assert {e.outcome for e in training.episodes} == {LATE}
    assert training.worlds.failures.tolist() == [0, 0]
    policy = LinearPolicy(2, 1, Identity(2))
    (found,) = evaluate(policy, {"weight": torch.zeros(1, 1, 2).double()}, World(sim), [0], 40)
    assert 0 < len(found) < 40 and {e.outcome for e in found} == {LATE}
