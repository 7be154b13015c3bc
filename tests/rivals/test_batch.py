"""The record of a random controller: what it holds, what it costs, what is rewarded."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.rivals.batch import (
    BatchSettings,
    Transitions,
    action_set,
    choices,
    collect,
    concatenated,
    rewards,
)
from edtorch.rivals.ledger import Account
from edtorch.run.scaled_sim import World
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.rivals.chain import ACTIONS, PLACES, Chain

FRONT = 6
"""Where in a bicycle's state the place of the front tyre is."""


def _collect(
    world: World,
    actions: Tensor,
    seed: int,
    episodes: range,
    steps: int | None,
    account: Account | None = None,
) -> Transitions:
    return collect(
        world,
        actions,
        seed=seed,
        episodes=episodes,
        steps=steps,
        account=account or Account(),
        pause=lambda: None,
    )


def test_the_record_follows_the_world_and_every_second_is_counted() -> None:
    account = Account()
    data = _collect(World(Chain()), ACTIONS, 3, range(200), 6, account)
    expected = (data.state + data.action).clamp(0, PLACES)
    assert data.next_state.equal(expected)
    assert data.terminated.equal(expected[:, 0] == PLACES)
    assert not bool(data.failed.any())
    same = data.episode[1:] == data.episode[:-1]
    assert bool((data.episode[1:] >= data.episode[:-1]).all())
    assert data.state[1:][same].equal(data.next_state[:-1][same])
    last = torch.cat((~same, torch.tensor([True])))
    assert bool((data.terminated ^ data.truncated)[last].all())
    assert not bool((data.terminated | data.truncated)[~last].any())
    assert account.seconds == len(data)
    assert (account.episodes, account.failures) == (200, 0)
    assert account.successes == int(data.terminated.sum()) > 0


def test_the_controller_is_uniform() -> None:
    """200 x 20 draws of 4 actions: counts within five standard deviations."""
    world = World(LinearSystem([[0.5]], [[1.0]], noise=0.0))
    actions = torch.tensor([[-1.0], [0.0], [0.5], [1.0]], dtype=torch.float64)
    data = _collect(world, actions, 1, range(200), 20)
    counts = choices(actions, data.action).bincount(minlength=4)
    assert (counts - 1000).abs().max() < 5 * math.sqrt(4000 * 0.25 * 0.75)


def test_an_episode_depends_on_seed_and_number_alone() -> None:
    world = World(Bicycle())
    actions = action_set(BatchSettings(), world)
    assert len(actions) == 9
    whole = _collect(world, actions, 7, range(6), 30)
    two = [_collect(world, actions, 7, numbers, 30) for numbers in (range(2), range(2, 6))]
    parts = concatenated(two)
    assert parts.state.equal(whole.state)
    assert parts.next_state.equal(whole.next_state)
    assert not _collect(world, actions, 8, range(6), 30).state.equal(whole.state)


def test_falls_end_episodes() -> None:
    world, account = World(Bicycle()), Account()
    data = _collect(world, action_set(BatchSettings(), world), 0, range(5), None, account)
    assert account.failures == account.episodes == 5 == int(data.failed.sum())
    lean = data.next_state[:, 0]  # in units of 12 degrees
    assert (lean.abs() > 1).equal(data.failed)


def test_rewards_are_sums_of_what_they_name() -> None:
    world = World(Bicycle())
    data = _collect(world, action_set(BatchSettings(), world), 0, range(3), None)
    settings = BatchSettings(
        reward_square={"lean": 2.0},
        reward_size={"angle_to_goal": 3.0},
        reward_cosine={"angle_to_goal": 5.0},
        reward_failure=-7.0,
    )
    found = rewards(settings, world.spec, data)
    for row in (0, len(data) // 2, int(data.failed.nonzero()[0])):
        lean, after = (float(s[row, 0]) * math.pi / 15 for s in (data.state, data.next_state))
        psi, later = (float(s[row, 4]) * math.pi for s in (data.state, data.next_state))
        expected = 2 * (lean**2 - after**2) + 3 * (abs(psi) - abs(later)) + 5 * math.cos(later)
        expected -= 7 * bool(data.failed[row])
        assert float(found[row]) == pytest.approx(expected, rel=1e-12)


def test_progress_of_the_front_wheel_is_metres_gained() -> None:
    """The cosine of the angle between the wheel's way and the goal, times the way, adds up to what
    the distance shrinks by, whatever the handlebar does."""
    sim, ticks = Bicycle(spread=0.0), 100
    world = World(sim)
    generator = torch.Generator().manual_seed(0)
    uniform = torch.rand(ticks, 50, world.uniforms, dtype=torch.float64, generator=generator)
    actions = action_set(BatchSettings(), world)
    chosen = torch.randint(len(actions), (ticks, 50), generator=generator)
    state = world.initial(uniform[0])
    seen = world.observe(state)
    speed = 10 / 3.6 * world.dt
    keys = ("angle_to_goal-handlebar", "angle_to_goal")
    wheel, frame = (BatchSettings(reward_cosine={key: speed}) for key in keys)
    gained, by_wheel, by_frame = (torch.zeros(50, dtype=torch.float64) for _ in range(3))
    for tick in range(ticks):
        before, seen_before = state, seen
        state = world.step(state, actions[chosen[tick]], uniform[tick])
        seen = world.observe(state)
        row = torch.zeros(50, dtype=torch.bool)
        step = Transitions(
            state=seen_before,
            action=actions[chosen[tick]],
            next_state=seen,
            dt=torch.full((50,), world.dt),
            episode=torch.arange(50),
            terminated=row,
            truncated=row,
            failed=row,
        )
        by_wheel += rewards(wheel, world.spec, step)
        by_frame += rewards(frame, world.spec, step)
        far = [torch.hypot(1000 - s[:, FRONT], s[:, FRONT + 1]) for s in (before, state)]
        gained += far[0] - far[1]
    # Metres of 2.78; the sim's way bends within a tick.
    assert gained.tolist() == pytest.approx(by_wheel.tolist(), abs=0.05)
    assert float((gained - by_frame).abs().max()) > 0.2


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({"discount": 1.0}, r"discount=1\.0: expected a number in \[0, 1\)"),
        ({"steps": 0}, r"steps=0: expected an integer >= 1"),
        ({"reward_failure": math.nan}, r"reward_failure=nan: expected a finite number"),
        ({"reward_size": {"a": math.inf}}, r"reward_size\.a=inf: expected a finite number"),
    ],
    ids=str,
)
def test_refuses_impossible_settings(settings: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        BatchSettings(**settings)


@pytest.mark.parametrize(
    ("actions", "wanted"),
    [
        ([[0.0]], r"actions\[0\]=\[0\.0\]: expected 2 finite numbers"),
        ([[3.0, 0.0], [0.0, 0.0]], r"actions\[0\].*handlebar_torque in \[-2, 2\]"),
        ([[0.0, 0.0], [0.0, 0.0]], r"expected at least two, all different"),
    ],
    ids=str,
)
def test_refuses_actions_that_the_domain_has_not(actions: list[list[float]], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        action_set(BatchSettings(actions=actions), World(Bicycle()))


def test_without_bounds_actions_must_be_named() -> None:
    with pytest.raises(ValueError, match=r"actions=\[\]: expected vectors of 1 numbers"):
        action_set(BatchSettings(), World(LinearSystem([[0.5]], [[1.0]])))


def test_rewards_of_unknown_components_are_refused() -> None:
    world = World(Bicycle())
    data = _collect(world, action_set(BatchSettings(), world), 0, range(1), 2)
    for settings, wanted in (
        (BatchSettings(reward_size={"lena": 1.0}), r"reward_size\.lena=1\.0: expected one of lean"),
        (BatchSettings(reward_cosine={"lean_rate": 1.0}), r"lean_rate=1\.0: expected an angle"),
        (
            BatchSettings(reward_cosine={"angle_to_goal-lean-lean": 1.0}),
            r"angle_to_goal-lean-lean=1\.0: expected an angle in rad or one-other, of lean, ",
        ),
    ):
        with pytest.raises(ValueError, match=wanted):
            rewards(settings, world.spec, data)
