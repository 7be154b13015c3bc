"""The loop: populations equal singles, same seed same digits, budgets, records, evaluation."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from edtorch.learner.learner import Learner
from edtorch.model.features import Identity
from edtorch.model.fit import AbsoluteError, Fit, RecursiveLeastSquares, SquaredError
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import PlainStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.evaluation import evaluate
from edtorch.run.scaled_sim import World
from edtorch.run.state_file import load_state, save_state
from edtorch.run.training import Training
from edtorch.run.trees import tensors_of
from edtorch.transform import SecondOrder
from edtorch.types import Parameters
from edtorch.value.choose import choose_path
from edtorch.value.unroll import Horizon
from sims.base import Outcome
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.systems import bicycle_learner, bicycle_training, next_state_model


def run(training: Training, chunk: int = 137) -> Training:
    while not training.done:
        training.advance(chunk)
    return training


def same(a: Training, row: int, b: Training, other: int) -> bool:
    """Whether two learners have lived the same life to the last digit."""
    pairs = [
        (a.learners.model["weight"], b.learners.model["weight"]),
        (a.learners.policy["weight"], b.learners.policy["weight"]),
        (a.learners.tick, b.learners.tick),
        (a.worlds.world, b.worlds.world),
        *((a.learners.fit[k], b.learners.fit[k]) for k in a.learners.fit),
    ]
    own = [(e.start, e.seconds, e.outcome, e.measures) for e in a.episodes if e.row == row]
    others = [(e.start, e.seconds, e.outcome, e.measures) for e in b.episodes if e.row == other]
    # Written out, since nan is not equal to itself.
    return all(torch.equal(x[row], y[other]) for x, y in pairs) and repr(own) == repr(others)


@pytest.mark.parametrize(
    "fit",
    [
        AbsoluteError(1.0),
        pytest.param(SquaredError(10.0), marks=pytest.mark.long),
        pytest.param(RecursiveLeastSquares(), marks=pytest.mark.long),
    ],
)
def test_a_population_equals_its_members_bit_for_bit(fit: Fit) -> None:
    budget = Budget(seconds=7.0)
    together = run(bicycle_training([7 + k for k in range(8)], budget, fit=fit))
    assert len(together.episodes) > 8
    for k in (0, 3, 7):
        assert same(run(bicycle_training([7 + k], budget, fit=fit)), 0, together, k)


def test_a_population_equals_its_members_while_others_wait() -> None:
    """Learners that used up their episodes wait; nobody's digits change."""
    budget = Budget(seconds=20.0, episodes=2)
    together = run(bicycle_training([0, 1, 2], budget))
    assert together.worlds.episodes.tolist() == [2, 2, 2]
    assert len(set(together.learners.tick.tolist())) > 1
    for k in range(3):
        assert same(run(bicycle_training([k], budget)), 0, together, k)


def test_same_seed_same_digits_and_other_seed_others() -> None:
    first, second = (run(bicycle_training([3], Budget(seconds=6.0)), c) for c in (100, 77))
    assert same(first, 0, second, 0)
    assert not same(first, 0, run(bicycle_training([4], Budget(seconds=6.0))), 0)


def test_single_precision_learns_as_well() -> None:
    world = World(Bicycle(), torch.float32)
    training = run(Training(bicycle_learner(world), world, [0, 1], Budget(seconds=4.0)))
    assert training.learners.policy["weight"].dtype == torch.float32
    assert bool(training.finite.all()) and bool(training.learners.policy["weight"].any())


class HotterInTheMiddle(ResidualNoise):
    """Noise that falls off so steeply that its curvature outweighs it."""

    is_constant: ClassVar[bool] = False

    def covariance(self, memory: Parameters, phi: Tensor) -> Tensor:
        size = torch.exp(-50 * phi.square().sum(-1))
        return size[..., None, None] * (memory["nu"] + 1e-3 * torch.eye(memory["nu"].shape[-1]))


def test_floored_covariances_are_seen_with_the_step_at_which_that_began() -> None:
    world = World(LinearSystem([[1.0]], [[0.5]], time_limit=20.0))
    model, policy = next_state_model(1, 1), LinearPolicy(1, 1, Identity(1))
    reward = QuadraticReward(torch.eye(1).double(), torch.zeros(1, 1).double())
    rule = HotterInTheMiddle(1.0)
    path = choose_path(
        "auto",
        model,
        policy,
        reward,
        SecondOrder(),
        Horizon(4, 1.0, 1.0, 1.0),
        noise=rule,
        start_cov=torch.eye(1).double(),
    ).path
    learner = Learner(model, policy, SquaredError(0.1), rule, path, PlainStep(0.0), 0.1)
    training = Training(learner, world, [0, 1], Budget(seconds=3.0))
    assert training.first_floored.tolist() == [-1, -1]
    run(training)
    assert all(1 <= step <= 4 for step in training.first_floored.tolist())
    assert bool(training.finite.all())
    calm = run(bicycle_training([0], Budget(seconds=1.0)))
    assert calm.first_floored.tolist() == [-1]


def test_budgets_count_per_learner() -> None:
    seconds = run(bicycle_training([0, 1], Budget(seconds=2.5)))
    assert seconds.learners.tick.tolist() == [250, 250] and seconds.seconds == 2.5
    episodes = run(bicycle_training([0, 1], Budget(episodes=2)))
    assert [sum(e.row == k for e in episodes.episodes) for k in (0, 1)] == [2, 2]
    # A disc as large as the start reaches: every episode succeeds within a tick.
    goal = Bicycle(goal_radius=1002.0)
    met = run(bicycle_training([0], Budget(successes=3, seconds=100.0), sim=goal))
    assert met.worlds.successes.tolist() == [3] and met.clock == 3
    with pytest.raises(ValueError, match="no budget"):
        Budget()


def test_a_time_out_is_a_ride_and_a_fall_is_none() -> None:
    training = run(bicycle_training([0], Budget(episodes=4), sim=Bicycle(time_limit=1.0)))
    outcomes = [e.outcome for e in training.episodes]
    assert Outcome.TIMED_OUT in outcomes
    assert training.worlds.successes.item() == sum(
        e.success is not False and e.outcome != Outcome.FAILED for e in training.episodes
    )
    assert training.worlds.failures.item() == outcomes.count(Outcome.FAILED)
    assert all(e.seconds <= 1.0 + 1e-9 for e in training.episodes)


def test_episodes_follow_one_another_without_gaps() -> None:
    training = run(bicycle_training([0, 1], Budget(seconds=15.0)))
    for row in (0, 1):
        own = [e for e in training.episodes if e.row == row]
        assert [e.number for e in own] == list(range(len(own)))
        for before, after in itertools.pairwise(own):
            assert after.start == pytest.approx(before.start + before.seconds)


def test_the_trail_holds_the_states_of_an_episode() -> None:
    training = run(bicycle_training([5], Budget(episodes=3)))
    last = training.episodes[-1]
    states = training.path(last)
    assert abs(states.shape[0] - last.seconds / 0.1) <= 1
    # The bicycle rides at 10 km/h: its front tyre moves v dt a tick.
    moved = (states[1:, 6:8] - states[:-1, 6:8]).norm(dim=-1)
    assert torch.allclose(moved, torch.full_like(moved, 10 / 3.6 * 0.1), rtol=0.05)


def test_snapshots_average_over_the_ticks_in_between() -> None:
    training = bicycle_training([0, 1], Budget(seconds=3.0))
    training.advance(100)
    snapshot = training.snapshot()
    assert snapshot.seconds == 1.0 and snapshot.active == [True, True]
    assert all(v < 0 for v in snapshot.value) and all(g > 0 for g in snapshot.gradient)
    run(training)
    assert training.snapshot().active == [False, False]
    assert all(v != v for v in training.snapshot().value)


@pytest.mark.long
@pytest.mark.oracle
def test_the_learner_learns_to_ride() -> None:
    """Five to seven falls, then no more: 60 simulated seconds of two learners."""
    training = run(bicycle_training([0, 1], Budget(seconds=60.0)), 500)
    assert all(count <= 15 for count in training.worlds.failures.tolist())
    assert all(60 - float(b) * 0.01 > 25 for b in training.worlds.begun)
    sim = Bicycle(time_limit=20.0)
    policy, parameters = training.learner.policy, training.learners.policy
    fresh = evaluate(policy, parameters, World(sim), [0, 1], 20)
    ridden = [e for own in fresh for e in own if e.outcome is Outcome.TIMED_OUT]
    assert len(ridden) >= 36


def test_interrupted_equals_uninterrupted_bit_for_bit(tmp_path: Path) -> None:
    budget = Budget(seconds=8.0)

    def fresh():
        return bicycle_training([0, 1], budget, fit=RecursiveLeastSquares())

    whole, first, second = fresh(), fresh(), fresh()
    whole.advance(800)
    first.advance(333)
    save_state(tmp_path / "saved.safetensors", first.state())
    second.restore(load_state(tmp_path / "saved.safetensors"), first.episodes)
    second.advance(800 - 333)
    assert second.clock == whole.clock
    one, other = (tensors_of(t.stage.population) for t in (second, whole))
    assert all(torch.equal(one[name], other[name]) for name in other)
    # Written out, since nan is not equal to itself.
    assert repr(second.episodes) == repr(whole.episodes) and len(whole.episodes) > 0
    last = [e for e in whole.episodes if e.row == 0][-1]
    assert torch.equal(second.path(last), whole.path(last))
    assert repr(second.snapshot()) == repr(whole.snapshot())


def test_a_larger_budget_goes_on_from_the_end_of_a_smaller_one() -> None:
    """With the digits of one that had been larger from the beginning."""
    whole, longer = (bicycle_training([0, 1], Budget(seconds=6.0)) for _ in range(2))
    shorter = bicycle_training([0, 1], Budget(seconds=2.5))
    whole.advance(600)
    assert shorter.advance(600) == 250 and shorter.done
    longer.restore(shorter.state(), shorter.episodes)
    assert not longer.done and longer.advance(600) == 350
    one, other = (tensors_of(t.stage.population) for t in (longer, whole))
    assert all(torch.equal(one[name], other[name]) for name in other)


def test_learners_that_were_done_go_on_waiting() -> None:
    budget = Budget(seconds=20.0, episodes=3)
    first, second = (bicycle_training([0, 1, 2], budget) for _ in range(2))
    while bool(first.worlds.active.all()):
        first.advance(1)
    second.restore(first.state(), first.episodes)
    waiting = int((~first.worlds.active).nonzero()[0])
    before = second.worlds.world[waiting].clone()
    second.advance(50)
    assert torch.equal(second.worlds.world[waiting], before)
    first.advance(50)
    assert torch.equal(second.worlds.world, first.worlds.world)


def test_a_state_does_not_go_into_another_population() -> None:
    state = bicycle_training([0, 1], Budget(seconds=1.0)).state()
    with pytest.raises(ValueError, match=r"seeds: the state has \[0, 1\], expected \[0, 2\]"):
        bicycle_training([0, 2], Budget(seconds=1.0)).restore(state, [])
    other = bicycle_training([0, 1], Budget(seconds=1.0), fit=RecursiveLeastSquares())
    with pytest.raises(ValueError, match=r"learners\.fit\."):
        other.restore(state, [])
