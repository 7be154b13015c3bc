"""Random policy search: equal to one plain loop, whatever the order and the processes."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.report.domain import domain_of
from edtorch.report.milestones import milestone_figures
from edtorch.report.proportions import Proportion, same_rate
from edtorch.rivals.random_search import (
    Progress,
    RandomSearch,
    Report,
    SearchResult,
    Shard,
    ShardStates,
    combined,
    episode_key,
    policy_weights,
    search,
)
from edtorch.run.hashing import uniform
from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.bicycle import Bicycle, Physics
from sims.linear import LinearSystem
from tests.states import read_back

BICYCLE = domain_of(Bicycle().spec)
FEW = RandomSearch(policies=24, runs=4, slots=16, look=5)


def _policy(world: World) -> LinearPolicy:
    states, actions = len(world.spec.state), len(world.spec.action)
    return LinearPolicy(states, actions, Identity(states))


def _short_ride() -> World:
    """A goal close by, little time and a narrow upright: every outcome comes, and soon."""
    return World(
        Bicycle(
            time_limit=0.3,
            start_heading_low=-math.pi / 2 - 0.6,
            start_heading_high=-math.pi / 2 + 0.6,
            goal_radius=998.2,
            clip_action=False,
            physics=Physics(omega_max=0.02),
        )
    )


def _search(settings: RandomSearch, world: World, **more: Any) -> SearchResult:
    options: dict[str, Any] = {
        "seed": 5,
        "processes": 1,
        "native": "off",
        "report": lambda *told: None,
        **more,
    }
    return search(settings, world, _policy(world), **options)


def _plainly(world: World, weight: Tensor, key: Tensor) -> tuple[int, int, Tensor]:
    """One episode on its own, tick by tick: outcome, ticks, final state."""
    policy, weights = _policy(world), {"weight": weight[None]}
    state = world.initial(uniform(key[None], torch.zeros(1, dtype=torch.int64), world.uniforms))
    ticks, outcome = 0, int(Outcome.RUNNING)
    while outcome == int(Outcome.RUNNING):
        ticks += 1
        clock = torch.tensor([ticks])
        action = world.clip(policy.action(weights, world.observe(state)))
        state = world.step(state, action, uniform(key[None], clock, world.uniforms))
        outcome = int(world.outcome(state, clock))
    return outcome, ticks, state


@pytest.fixture(scope="module")
def plain() -> tuple[Tensor, Tensor]:
    """Outcome and ticks ``[P, R]`` of all runs, without early rejection."""
    world = _short_ride()
    outcome = torch.zeros(FEW.policies, FEW.runs, dtype=torch.int8)
    ticks = torch.zeros(FEW.policies, FEW.runs, dtype=torch.int32)
    ids = torch.arange(FEW.policies)
    with torch.inference_mode():
        weights = policy_weights(FEW, _policy(world), 5, ids)
        for p in range(FEW.policies):
            for r in range(FEW.runs):
                key = episode_key(5, ids[p], torch.tensor(r))
                outcome[p, r], ticks[p, r], _ = _plainly(world, weights[p], key)
    return outcome, ticks


@pytest.mark.oracle
def test_early_rejection_changes_nothing_but_the_cost(plain: tuple[Tensor, Tensor]) -> None:
    outcome, ticks = plain
    found = _search(FEW, _short_ride())
    failed = outcome == int(Outcome.FAILED)
    assert found.goal.equal((outcome == int(Outcome.SUCCEEDED)).all(-1))
    assert found.stable.equal(~failed.any(-1) & ~found.goal)
    assert 0 < int(found.goal.sum()) < FEW.policies
    assert int(found.stable.sum()) > 0
    needed = failed.cumsum(-1) - failed.long() == 0
    assert not bool(needed.all())
    assert found.outcome.equal(torch.where(needed, outcome, 0))
    assert found.ticks.equal(torch.where(needed, ticks, 0))
    assert found.steps == int(ticks[needed].sum()) <= found.steps_done
    assert found.episodes == int(needed.sum())


@pytest.mark.oracle
@pytest.mark.parametrize(("slots", "look"), [(3, 1), (7, 64), (200, 7)])
def test_slots_do_not_matter(slots: int, look: int) -> None:
    world = _short_ride()
    reference = _search(FEW, world)
    found = _search(dataclasses.replace(FEW, slots=slots, look=look), world)
    assert found.outcome.equal(reference.outcome)
    assert found.ticks.equal(reference.ticks)
    for name, values in reference.measures.items():
        assert found.measures[name].nan_to_num().equal(values.nan_to_num()), name


@pytest.mark.long
@pytest.mark.experiment
def test_processes_and_kernels_do_not_matter() -> None:
    world = _short_ride()
    reference, found = _search(FEW, world), _search(FEW, world, processes=2, native="auto")
    assert found.policy.equal(torch.arange(FEW.policies))
    assert found.outcome.equal(reference.outcome)
    assert found.ticks.equal(reference.ticks)
    for name, values in reference.measures.items():
        torch.testing.assert_close(found.measures[name], values, equal_nan=True)


def test_a_search_that_finds_nothing() -> None:
    """No policy to the goal: there are no measures, and nothing breaks."""
    world = World(Bicycle(time_limit=0.05, clip_action=False))
    found = _search(RandomSearch(policies=3, runs=2, slots=4, look=3), world)
    assert bool(found.stable.all())
    assert bool(found.measures["path_length_m"].isnan().all())


def test_seeds_are_other_searches() -> None:
    world = _short_ride()
    assert not _search(FEW, world).ticks.equal(_search(FEW, world, seed=6).ticks)


def test_a_policy_is_the_same_in_a_smaller_search() -> None:
    world = _short_ride()
    smaller = dataclasses.replace(FEW, policies=10)
    assert _search(smaller, world).ticks.equal(_search(FEW, world).ticks[:10])


def test_measures_are_means_of_the_goal_policies() -> None:
    found = _search(FEW, _short_ride())
    seconds = found.ticks.double() * 0.01
    times = found.measures["goal_time_s"]
    torch.testing.assert_close(times[found.goal], seconds.mean(-1)[found.goal])
    assert bool(times[~found.goal].isnan().all())
    torch.testing.assert_close(found.measures["path_length_m"], times * 10 / 3.6, equal_nan=True)


def test_a_world_without_failures_is_all_stable() -> None:
    """Nobody falls and nobody arrives: every run of every policy is needed."""
    world = World(LinearSystem([[0.5]], [[0.1]], dt=1.0, time_limit=4.0))
    found = _search(RandomSearch(policies=5, runs=3, slots=4, look=3), world)
    assert bool(found.stable.all())
    assert found.ticks.equal(torch.full((5, 3), 4, dtype=torch.int32))


def test_weights_are_uniform() -> None:
    world = _short_ride()
    settings = RandomSearch(low=-1.0, high=3.0)
    weights = policy_weights(settings, _policy(world), 0, torch.arange(20_000))
    assert weights.shape == (20_000, 2, 5)
    assert float(weights.min()) >= -1 and float(weights.max()) < 3
    assert float((weights.mean(0) - 1).abs().max()) < 5 * (16 / 12 / 20_000) ** 0.5
    covariance = torch.cov(weights.flatten(1).T) - torch.eye(10, dtype=torch.float64) * 16 / 12
    assert float(covariance.abs().max()) < 0.06


def test_progress_ends_with_the_result() -> None:
    world = _short_ride()
    reports: list[Progress] = []
    found = _search(FEW, world, report=lambda progress, states: reports.append(progress))
    last = reports[-1]
    assert (last.decided, last.goal, last.stable, last.steps) == (
        FEW.policies,
        int(found.goal.sum()),
        int(found.stable.sum()),
        found.steps_done,
    )


def test_a_report_that_raises_ends_the_search() -> None:
    world = _short_ride()

    def stop(progress: Progress, states: ShardStates) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _search(FEW, world, report=stop)


def _assert_the_same(found: SearchResult, wanted: SearchResult) -> None:
    for name in ("policy", "outcome", "ticks"):
        assert getattr(found, name).equal(getattr(wanted, name)), name
    assert found.steps_done == wanted.steps_done
    for name, values in wanted.measures.items():
        assert values.allclose(found.measures[name], rtol=0, atol=0, equal_nan=True), name


def test_it_goes_on_from_every_round_as_if_nothing_had_been() -> None:
    """The states of three rounds, and of the end; the steps that were not needed included."""
    world = _short_ride()
    told: list[tuple[Progress, Any]] = []
    wanted = _search(
        FEW, world, report=lambda progress, states: told.append((progress, read_back(list(states))))
    )
    rounds = {
        own["count"]: states for _, states in told if states[0] for own in [states[0]["found"]]
    }
    assert list(rounds) == [1, 2, 4]
    for states in rounds.values():
        latest: list[Progress] = []
        more = {
            "states": states,
            "report": lambda progress, _, latest=latest: latest.append(progress),
        }
        found = _search(FEW, world, **more)
        _assert_the_same(found, wanted)
        assert latest[-1] == told[-1][0]
        assert found.cpu_s > states[0]["spent"]["cpu_s"]


@pytest.mark.long
@pytest.mark.experiment
def test_processes_go_on_too() -> None:
    """One that has ended two rounds, and one that has ended none."""
    world = _short_ride()
    shards = [Shard(FEW, world, _policy(world), 5, "off", first, 2) for first in range(2)]
    told: list[Report] = []
    wanted = combined([shard(told.append) for shard in shards])
    second = [report.state for report in told if report.state is not None][1]
    found = _search(FEW, world, processes=2, states=[read_back(second), None])
    _assert_the_same(found, wanted)


@pytest.mark.parametrize(
    ("argument", "wanted"),
    [
        ({"policies": 0}, "policies=0: expected an integer >= 1"),
        ({"runs": 0}, "runs=0: expected an integer >= 1"),
        ({"slots": 1}, "slots=1: expected an integer >= 2"),
        ({"look": 0}, "look=0: expected an integer >= 1"),
        ({"policies": 2**31}, "policies=2147483648: expected less than"),
        ({"low": 2.0}, "low=2.0: expected less than high"),
    ],
)
def test_refuses(argument: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        RandomSearch(**argument)


@pytest.mark.reference
@pytest.mark.parametrize(
    ("six", "goal", "stable", "total"),
    [(False, 276, 254, 100_000), (True, 496, 829, 82_000)],
)
def test_footnote_1(six: bool, goal: int, stable: int, total: int) -> None:
    """Compiled, 10,000 policies: the shares that an independent simulator found."""
    scale = {"handlebar": 0.5, "handlebar_rate": 2.0, "lean": 0.15, "lean_rate": 0.25}
    world = World(
        Bicycle(
            time_limit=600.0,
            start_heading_low=0.0,
            start_heading_high=0.0,
            goal_radius=2.0,
            clip_action=False,
            lean_acceleration=six,
            state_scale=scale,
        )
    )
    settings = RandomSearch(policies=10_000)
    found = _search(settings, world, seed=0, processes=2, native="on")
    for count, expected in ((found.goal, goal), (found.stable, stable)):
        share = Proportion(int(count.sum()), settings.policies)
        assert same_rate(share, Proportion(expected, total)) > 0.001
    distance = float(found.measures["path_length_m"][found.goal].median())
    assert abs(distance - (1008 if six else 1006)) < 4


def test_what_a_search_had_paid_at_its_milestone_figures() -> None:
    """Policy after policy, each dropped at its first failure: counted here run by run."""
    found = _search(FEW, _short_ride())
    names = {"stable": Outcome.FAILED, "goal": Outcome.SUCCEEDED}
    told = milestone_figures([found.history(0.01, 1e-3)], [5], BICYCLE)
    for name, wanted in names.items():
        episodes = falls = ticks = 0
        for outcomes, lasted in zip(found.outcome.tolist(), found.ticks.tolist(), strict=True):
            good = True
            for outcome, count in zip(outcomes, lasted, strict=True):
                episodes += 1
                ticks += count
                falls += outcome == Outcome.FAILED
                good = good and (outcome == wanted) == (wanted is Outcome.SUCCEEDED)
                if outcome == Outcome.FAILED:
                    break
            if good:
                break
        paid = told[name]
        assert paid["never"] == []
        assert paid["episodes"]["per_seed"] == [episodes]
        assert paid["falls"]["per_seed"] == [falls]
        assert paid["seconds"]["median"] == pytest.approx(ticks * 0.01)
        assert paid["cpu_s"]["median"] == pytest.approx(ticks * 1e-3)
    first = int(found.goal.nonzero()[0])
    length = float(found.measures["path_length_m"][first])
    assert told["goal"]["path_length_m"]["per_seed"] == [pytest.approx(length)]


def test_a_search_without_milestones_has_paid_for_all_of_it() -> None:
    world = World(LinearSystem([[3.0]], [[0.0]], dt=1.0, time_limit=50.0))
    found = _search(RandomSearch(policies=5, runs=3, slots=4, look=3), world)
    told = milestone_figures([found.history(1.0, 0.0)], [8], BICYCLE)
    for name in ("stable", "goal"):
        assert told[name]["never"] == [8]
        assert told[name]["episodes"]["per_seed"] == [found.episodes] == [5]
        assert told[name]["seconds"]["per_seed"] == [found.steps]
