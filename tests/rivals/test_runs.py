"""Episodes in a tile that add something up: equal to one plain loop, whatever else is run."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.rivals.episodes import looped, one_tick, scanned
from edtorch.rivals.reinforce import LikelihoodRatio
from edtorch.rivals.returns import Return, SparseReward
from edtorch.rivals.runs import Runs, can_try, evaluator, fresh_episodes
from edtorch.run.hashing import Use, hash_key, normals, uniform
from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.bicycle import Bicycle
from tests.rivals.problems import pause

DISCOUNT = 0.7


def _world() -> World:
    return World(Bicycle(time_limit=3.0, start_heading_low=-2.0, start_heading_high=-1.0))


def _reward() -> QuadraticReward:
    generator = torch.Generator().manual_seed(1)
    half = torch.randn(5, 5, generator=generator, dtype=torch.float64)
    return QuadraticReward(half.T @ half, torch.eye(2, dtype=torch.float64))


def _weights(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(2)
    return torch.randn(count, 2, 5, generator=generator, dtype=torch.float64)


def _keys(count: int) -> Tensor:
    return hash_key(Use.SCENARIO, 7, torch.arange(count))


def _plainly(weight: Tensor, key: Tensor, limit: int) -> tuple[int, int, float]:
    """One episode on its own: outcome, ticks, discounted return."""
    world, reward = _world(), _reward()
    key = key[None]
    state = world.initial(uniform(key, torch.tensor([0]), world.uniforms))
    total, ticks, outcome = 0.0, 0, int(Outcome.RUNNING)
    while outcome == int(Outcome.RUNNING):
        observation = world.observe(state)
        action = world.clip(observation @ weight.T)
        total += DISCOUNT ** (0.01 * ticks) * 0.01 * float(reward(observation, action))
        ticks += 1
        clock = torch.tensor([ticks])
        state = world.step(state, action, uniform(key, clock, world.uniforms))
        outcome = int(world.outcome(state, clock))
        if outcome == int(Outcome.RUNNING) and ticks >= limit:
            outcome = int(Outcome.TIMED_OUT)
    return outcome, ticks, total


@pytest.mark.oracle
@pytest.mark.parametrize(("slots", "look"), [(16, 64), (3, 7)])
def test_returns_are_those_of_a_plain_loop(slots: int, look: int) -> None:
    world = _world()
    accumulator = Return(SparseReward(_reward()), DISCOUNT, world.dt)
    policy = LinearPolicy(5, 2, Identity(5))
    runs = Runs(
        world, policy, mode="off", slots=slots, look=look, accumulator=accumulator, limit=120
    )
    weight, key = _weights(8), _keys(8)
    outcomes: set[int] = set()
    for _ in range(2):
        ended = runs(weight, key, pause)
        outcomes |= set(ended.outcome.tolist())
        for k in range(8):
            outcome, ticks, total = _plainly(weight[k], key[k], 120)
            assert (int(ended.outcome[k]), int(ended.ticks[k])) == (outcome, ticks)
            assert float(ended.sums[0][k]) == pytest.approx(total, rel=1e-9)
    assert outcomes == {int(Outcome.FAILED), int(Outcome.TIMED_OUT)}


@pytest.mark.oracle
def test_a_loop_in_the_graph_changes_nothing() -> None:
    """With exploration and all sums of a likelihood ratio."""
    world = _world()
    policy = LinearPolicy(5, 2, Identity(5))
    accumulator = LikelihoodRatio(SparseReward(_reward()), policy.features, 5, 2, 0.3, 0.99, 0.01)
    tick = one_tick(world, policy, accumulator, 100)
    weight, key = _weights(6), _keys(6)
    zero = torch.zeros(6, dtype=torch.int64)
    with torch.inference_mode():
        state = world.initial(uniform(key, zero, world.uniforms))
        arguments = (state, weight, key, zero, zero.clone(), *accumulator.begin(6))
        found = zip(looped(tick, 40)(*arguments), scanned(tick, 40)(*arguments), strict=True)
        assert all(one.equal(other) for one, other in found)


def test_normals_are_standard_normal() -> None:
    numbers = uniform(hash_key(Use.EPISODE, 0), torch.arange(50_000), 2)
    drawn = normals(numbers)
    assert bool(drawn.isfinite().all())
    covariance = torch.cov(drawn.T)
    torch.testing.assert_close(covariance, torch.eye(2).double(), atol=0.03, rtol=0)
    assert float(drawn.mean(0).abs().max()) < 4 / math.sqrt(50_000)
    beyond = float((drawn.abs() > 1.959964).double().mean())
    assert beyond == pytest.approx(0.05, abs=4 * math.sqrt(0.05 * 0.95 / 100_000))
    edges = torch.tensor([[0.0, 0.5], [1 - 2.0**-32, 0.5]], dtype=torch.float64)
    assert bool(normals(edges).isfinite().all())


def test_fresh_episodes() -> None:
    """As their outcomes and ticks say; those of a seed do not depend on what is tried beside it."""
    world = _world()
    policy = LinearPolicy(5, 2, Identity(5))
    runs = evaluator(world, policy, mode="off", slots=4)
    weight = _weights(2)
    both = fresh_episodes(runs, world, weight, [4, 9], 3, pause)
    alone = fresh_episodes(runs, world, weight[1:], [9], 3, pause)
    assert [(e.seconds, e.outcome) for e in both[1]] == [(e.seconds, e.outcome) for e in alone[0]]
    assert len({e.seconds for own in both for e in own}) > 1
    key = hash_key(Use.FRESH, 4, torch.arange(3))
    for episode in both[0]:
        outcome, ticks, _ = _plainly(weight[0], key[episode.number], 10**6)
        assert (int(episode.outcome), round(episode.seconds / 0.01)) == (outcome, ticks)
        length = episode.measures["path_length_m"]
        assert length == pytest.approx(episode.seconds * 10 / 3.6)


@pytest.mark.parametrize("threshold", [None, -3.0])
def test_fresh_episodes_have_return_and_success(threshold: float | None) -> None:
    """The undiscounted sum of dt r over a plain loop; a success by the rules of the world."""
    sim = Bicycle(time_limit=0.5)
    world = World(sim, reward=_reward(), success_return=threshold)
    policy, weight, key = LinearPolicy(5, 2, Identity(5)), _weights(1), _keys(4)
    key = hash_key(Use.FRESH, 3, torch.arange(4))
    runs = evaluator(world, policy, mode="off", slots=4)
    (own,) = fresh_episodes(runs, world, weight, [3], 4, pause)
    for episode in own:
        state = world.initial(uniform(key[episode.number, None], torch.tensor([0]), world.uniforms))
        total = 0.0
        for ticks in range(1, round(episode.seconds / 0.01) + 1):
            observation, clock = world.observe(state), torch.tensor([ticks])
            action = world.clip(observation @ weight[0].T)
            total += 0.01 * float(_reward()(observation, action))
            numbers = uniform(key[episode.number, None], clock, world.uniforms)
            state = world.step(state, action, numbers)
        assert episode.total_reward == pytest.approx(total, rel=1e-9)
        lasted = episode.seconds == pytest.approx(0.5)
        assert episode.success is (lasted if threshold is None else total >= threshold)


def test_what_can_be_tried_so() -> None:
    assert can_try(World(Bicycle()))
    assert not can_try(World(Bicycle(), unwrap=1.5))
    assert not can_try(World(Bicycle(spread=0.3)))


@pytest.mark.oracle
def test_single_precision_is_nearly_the_same() -> None:
    """The zero policy, whose falls do not depend on what is observed: to the tick."""
    ended = []
    for dtype in (torch.float64, torch.float32):
        world = World(Bicycle(time_limit=3.0), dtype)
        policy = LinearPolicy(5, 2, Identity(5), dtype)
        accumulator = Return(SparseReward(_reward()), DISCOUNT, world.dt)
        runs = Runs(world, policy, mode="off", slots=6, accumulator=accumulator)
        ended.append(runs(torch.zeros(6, 2, 5), _keys(6), pause))
    double, single = ended
    assert double.ticks.equal(single.ticks)
    torch.testing.assert_close(double.sums[0], single.sums[0], rtol=1e-5, atol=0)
