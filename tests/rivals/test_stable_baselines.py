"""A world as stable-baselines3 sees it: rewards, ends, accounts, and random numbers."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.rewards import QuadraticReward
from edtorch.rivals.base import Problem
from edtorch.rivals.deep import Decisions
from edtorch.rivals.ledger import Account
from edtorch.rivals.ppo import PPO
from edtorch.rivals.sac import SAC
from edtorch.rivals.stable_baselines import WorldEnvs, action_box
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.bicycle import Bicycle
from tests.rivals.deep_problems import COST, PULL, carry_on, linear_problem


def _envs(problem: Problem, lesson: Decisions, seed: int = 0) -> tuple[WorldEnvs, Account]:
    account = Account()
    return WorldEnvs(problem.world, problem.reward, lesson, seed, account), account


def _step(
    envs: WorldEnvs, action: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
    envs.step_async(action)
    return envs.step_wait()


def _bicycle(**settings: float) -> World:
    return World(Bicycle(**settings))  # pyright: ignore[reportArgumentType]


def _upright(world: World) -> QuadraticReward:
    weights = [10.0 if q.name == "lean" else 0.0 for q in world.spec.state]
    return QuadraticReward(torch.diag(torch.tensor(weights).double()), torch.zeros(2, 2).double())


def test_rewards_are_the_integral_of_the_shaping_reward() -> None:
    """Three ticks of s' = PULL s + a with the action held, by hand."""
    envs, account = _envs(linear_problem([0], ticks=6, dt=0.5), Decisions(2, 3, 7.0, 4.0))
    s = envs.reset()[:, 0].astype(np.float64)
    action = np.array([[0.5], [-1.0]], dtype=np.float32)
    wanted = np.zeros(2)
    for _ in range(3):
        s = PULL * s + action[:, 0]
        wanted -= (s**2 + COST * action[:, 0] ** 2) * 0.5
    observation, reward, ended, infos = _step(envs, action)
    np.testing.assert_allclose(observation[:, 0], s, rtol=1e-6)
    np.testing.assert_allclose(reward, 4.0 * wanted, rtol=1e-6)
    assert not ended.any() and infos == [{}, {}]
    assert (account.seconds, account.episodes) == (3.0, 0)


def test_the_time_limit_truncates() -> None:
    """An episode of six ticks ends in the second decision of four, and goes on in the next."""
    envs, account = _envs(linear_problem([0], ticks=6, dt=0.5), Decisions(1, 4, 7.0, 1.0))
    start = envs.reset()
    zero = np.zeros((1, 1), dtype=np.float32)
    _step(envs, zero)
    observation, _, ended, infos = _step(envs, zero)
    assert ended.all() and infos[0]["TimeLimit.truncated"]
    np.testing.assert_allclose(infos[0]["terminal_observation"], start[0] * PULL**6, rtol=1e-5)
    assert observation[0, 0] != infos[0]["terminal_observation"][0]
    assert (account.seconds, account.episodes, account.successes, account.failures) == (
        3.0,
        1,
        1,
        0,
    )


def test_falls_cost_their_penalty_and_are_counted() -> None:
    """Torque and displacement to one side until the bicycle falls; by hand, tick by tick."""
    world = _bicycle()
    reward = _upright(world)
    account = Account()
    envs = WorldEnvs(world, reward, Decisions(1, 1, 3.0, 2.0), 5, account)
    draws = Streams([stream_key(5, Purpose.LEARNING, 0)], world.uniforms, 0)
    state = world.initial(draws.at(0).uniform)
    np.testing.assert_allclose(envs.reset(), world.observe(state).numpy(), rtol=1e-6)
    action = world.clip(torch.ones(1, 2, dtype=torch.float64))
    tick, fell = 0, False
    while not fell:
        tick += 1
        state = world.step(state, action, draws.at(tick).uniform)
        found, earned, ended, infos = _step(envs, np.ones((1, 2), dtype=np.float32))
        fell = int(world.outcome(state, torch.tensor([tick]))) == int(Outcome.FAILED)
        value = float(reward(world.observe(state), action)) * world.dt - 3.0 * fell
        assert float(earned[0]) == pytest.approx(2.0 * value, rel=1e-5, abs=1e-9)
        assert bool(ended[0]) == fell
        if fell:
            assert not infos[0]["TimeLimit.truncated"]
            final = world.observe(state).numpy()[0]
            np.testing.assert_allclose(
                infos[0]["terminal_observation"], final, rtol=1e-5, atol=1e-7
            )
            # The next episode has begun: upright, at rest.
            assert np.abs(found[0, :4]).max() == 0
    assert (account.episodes, account.failures, account.successes) == (1, 1, 0)
    assert account.seconds == pytest.approx(tick * 0.01, abs=1e-12)


def test_every_simulated_second_is_paid_once() -> None:
    """Copies that fall inside a held action pay for the ticks that they lived."""
    world = _bicycle()
    envs, account = _envs(_problem(world), Decisions(4, 7, 1.0, 1.0))
    envs.reset()
    for _ in range(40):
        _step(envs, np.ones((4, 2), dtype=np.float32))
    assert account.failures == account.episodes >= 4
    whole = 40 * 7 * 4 * 0.01
    # A fall wastes at most six of the seven ticks of its decision.
    assert whole - account.episodes * 6 * 0.01 - 1e-9 <= account.seconds < whole


def _problem(world: World) -> Problem:
    problem = linear_problem([0])
    return Problem(world, problem.policy, _upright(world), [0], "off")


def test_actions_reach_the_bounds() -> None:
    world = _bicycle()
    centre, radius = action_box(world)
    low = [q.low / q.scale for q in world.spec.action]
    high = [q.high / q.scale for q in world.spec.action]
    torch.testing.assert_close(centre - radius, torch.tensor(low, dtype=torch.float64))
    torch.testing.assert_close(centre + radius, torch.tensor(high, dtype=torch.float64))
    unbounded = action_box(linear_problem([0]).world)
    assert [t.tolist() for t in unbounded] == [[0.0], [1.0]]


def _seed_all() -> None:
    random.seed(1)
    np.random.seed(1)
    torch.manual_seed(1)


def _draw() -> tuple[float, float, Tensor]:
    return random.random(), np.random.random(), torch.rand(1)


SETTINGS = (
    SAC(steps=120, hidden=[8]),
    PPO(steps=64, copies=4, rollout=16, hidden=[8]),
)


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda s: type(s).__name__)
def test_a_seed_does_the_same_in_any_company(settings: SAC | PPO) -> None:
    """Beside another seed, in smaller pieces, with other people's draws between them."""
    together = settings.begin(linear_problem([3, 4], noise=0.1, ticks=5))
    for going in ([True, False], [True, True]):
        _draw()
        together.advance(going, carry_on)
    alone = settings.begin(linear_problem([3], noise=0.1, ticks=5))
    alone.advance([True], carry_on)
    alone.advance([True], carry_on)
    for name, found in together.parameters.items():
        if name != "number":
            assert found[0].equal(alone.parameters[name][0]), name
            assert not found[1].equal(found[0]), name
    assert together.accounts[0] == alone.accounts[0]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda s: type(s).__name__)
def test_nobody_else_s_numbers_are_touched(settings: SAC | PPO) -> None:
    _seed_all()
    wanted = _draw()
    _seed_all()
    search = settings.begin(linear_problem([0]))
    search.advance([True], carry_on)
    assert _draw() == wanted


class _Stop(Exception):
    pass


def test_what_a_pause_raises_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edtorch.rivals.stable_baselines.SECONDS_BETWEEN_PAUSES", 0.0)
    search = SETTINGS[0].begin(linear_problem([0]))

    def stop() -> None:
        raise _Stop

    with pytest.raises(_Stop):
        search.advance([True], stop)
    assert search.accounts[0].seconds < 120


def test_pieces_grow_and_each_seed_counts_its_own() -> None:
    search = SAC(steps=20, growth=1.5, hidden=[8]).begin(linear_problem([0, 1]))
    for going, paid in (
        ([True, True], [20, 20]),
        ([True, False], [50, 20]),
        ([True, True], [95, 50]),
    ):
        search.advance(going, carry_on)
        assert [account.seconds for account in search.accounts] == paid
