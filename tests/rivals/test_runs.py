"""Episodes that add something up: equal to one plain loop, compiled or not."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.rivals.episodes import Accumulator
from edtorch.rivals.native_episodes import EPISODE_LANES, NativeEpisodes
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
        world, policy, native="off", slots=slots, look=look, accumulator=accumulator, limit=120
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


def _kernels() -> list[Accumulator]:
    """What kernels add up."""
    reward = SparseReward(_reward())
    return [
        Return(reward, DISCOUNT, 0.01),
        LikelihoodRatio(reward, Identity(5), 5, 2, 0.3, 0.99, 0.01),
    ]


@pytest.mark.oracle
@pytest.mark.parametrize(
    "accumulator",
    [pytest.param(_kernels()[0], marks=pytest.mark.reference), _kernels()[1]],
    ids=["return", "likelihood"],
)
def test_a_kernel_does_the_same(accumulator: Accumulator) -> None:
    """Outcomes and ticks of falls and cut-offs, final states and sums to rounding; with the
    numbers of the hash, exploration included."""
    world, policy = _world(), LinearPolicy(5, 2, Identity(5))
    weight, key = _weights(40) / 2, _keys(40)
    found, wanted = (
        Runs(world, policy, native=native, accumulator=accumulator, limit=120)(weight, key, pause)
        for native in ("on", "off")
    )
    assert found.outcome.equal(wanted.outcome) and found.ticks.equal(wanted.ticks)
    assert set(found.outcome.tolist()) == {int(Outcome.FAILED), int(Outcome.TIMED_OUT)}
    pairs = zip((found.state, *found.sums), (wanted.state, *wanted.sums), strict=True)
    for one, other in pairs:
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.reference
def test_lanes_do_not_matter() -> None:
    """To the last bit; so neither does how many episodes there are."""
    world, policy, (accumulator, _) = _world(), LinearPolicy(5, 2, Identity(5)), _kernels()
    weight, key = _weights(40) / 2, _keys(40)
    start = world.initial(uniform(key, torch.zeros_like(key[:, 0]), world.uniforms))
    columns = []
    for lanes in (1, EPISODE_LANES):
        episodes = NativeEpisodes(world, policy, accumulator, 200, lanes=lanes)
        (ended,) = episodes.pieces(weight, key, start)
        order = ended.number.argsort()
        columns.append([x[order] for x in (ended.ticks, ended.state, *ended.sums)])
    assert all(one.equal(other) for one, other in zip(*columns, strict=True))


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
    runs = evaluator(world, policy, native="off")
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
    runs = evaluator(world, policy, native="off")
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
