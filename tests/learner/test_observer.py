"""Learners and frozen policies on readings that are late or err."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from edtorch.learner.delay import Delay
from edtorch.learner.filter import JointFilter
from edtorch.learner.learner import Learner
from edtorch.learner.observer import Observer
from edtorch.model.features import Identity
from edtorch.model.fit import RecursiveLeastSquares
from edtorch.model.models import NextStateModel
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import PlainStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.evaluation import evaluate
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.transform import MeanOnly
from edtorch.value.choose import choose_path
from edtorch.value.unroll import Horizon
from sims.linear import LinearSystem
from sims.sensing import Sensed
from tests.systems import f64

F, G = [[0.9, 0.3], [-0.2, 0.8]], [[0.0], [0.5]]
EXACT = f64([[0.9, 0.3, 0.0], [-0.2, 0.8, 0.5]])


def system(noise: float = 0.0) -> LinearSystem:
    return LinearSystem(F, G, noise=noise, dt=0.1, time_limit=3.0)


def learner_in(world: World, delay: int | None, *, filtered: bool = False) -> Learner:
    """Explores with a policy of zeros; delay: None for no observer at all."""
    model = NextStateModel(2, 1, Identity(3), world.period)
    policy = LinearPolicy(2, 1, Identity(2))
    reward = QuadraticReward(torch.eye(2, dtype=torch.float64), f64([[0.1]]))
    path = choose_path("auto", model, policy, reward, MeanOnly(), Horizon(5, 1.0, 1.0, 1.0)).path
    rule = JointFilter(model, f64([0.05, 0.05]), disturbance=0.01) if filtered else None
    observer = None
    if delay is not None:
        observer = Observer(model, Delay(delay), rule, world.seconds)
    return Learner(
        model=model,
        policy=policy,
        fit=rule or RecursiveLeastSquares(1e12),
        noise=None,
        value=path,
        step_rule=PlainStep(0.001),
        exploration=1.0,
        observer=observer,
    )


def trained(world: World, learner: Learner, seconds: float = 12.0) -> Training:
    training = Training(learner, world, [3, 5], Budget(seconds=seconds))
    training.advance(10**6)
    return training


@pytest.mark.parametrize("delay", [1, 3])
def test_the_known_delay_gives_back_the_exact_model(delay: int) -> None:
    world = World(Sensed(system(), delay=delay))
    found = trained(world, learner_in(world, delay))
    assert found.worlds.episodes.tolist() == [4, 4]
    torch.testing.assert_close(
        found.learners.model["weight"], EXACT.expand(2, 2, 3), rtol=0, atol=1e-6
    )
    ignored = trained(world, learner_in(world, None)).learners.model["weight"]
    assert float((ignored - EXACT).abs().amax((-1, -2)).min()) > 0.1


def test_no_delay_to_know_of_changes_nothing() -> None:
    world = World(system(0.1))
    with_it, without = (trained(world, learner_in(world, delay)) for delay in (0, None))
    assert torch.equal(with_it.learners.model["weight"], without.learners.model["weight"])
    assert torch.equal(with_it.learners.policy["weight"], without.learners.policy["weight"])
    assert torch.equal(with_it.worlds.world, without.worlds.world)


@pytest.mark.parametrize("delay", [1, 2])
def test_with_the_exact_model_a_policy_does_not_feel_the_delay(delay: int) -> None:
    def rides(sim: LinearSystem | Sensed, ticks: int) -> Tensor:
        world, seen = World(sim), list[Tensor]()
        learner = learner_in(world, ticks)
        parameters = {"weight": f64([[[-0.4, -0.7]]]), "model": EXACT.unsqueeze(0)}
        evaluate(
            learner.policy, parameters, world, [1], 3, watch=seen.append, observer=learner.observer
        )
        return torch.stack(seen)[..., :2]

    # The numbers of a start are drawn after those of the sensors.
    starts = Sensed(system(), delay=0)
    torch.testing.assert_close(rides(Sensed(system(), delay=delay), delay), rides(starts, 0))


def test_the_filter_finds_the_model_behind_readings_that_err_and_are_late() -> None:
    world = World(Sensed(system(0.01), {"state_0": 0.05, "state_1": 0.05}, delay=1))
    found = trained(world, learner_in(world, 1, filtered=True), seconds=100.0).learners
    assert float((found.model["weight"] - EXACT).abs().max()) < 0.03
    assert bool((found.sound_ticks == found.tick).all())


def test_interrupted_equals_uninterrupted_bit_for_bit() -> None:
    world = World(Sensed(system(0.01), {"state_0": 0.05, "state_1": 0.05}, delay=2))

    def fresh() -> Training:
        learner = learner_in(world, 2, filtered=True)
        return Training(learner, world, [3, 5], Budget(seconds=10.0))

    whole, first, second = fresh(), fresh(), fresh()
    whole.advance(100)
    first.advance(47)
    second.restore(first.state(), first.episodes)
    second.advance(53)
    for name in ("model", "policy", "fit", "observer"):
        mine, theirs = getattr(second.learners, name), getattr(whole.learners, name)
        assert theirs and all(torch.equal(mine[k], theirs[k]) for k in theirs)


def test_a_learner_of_a_population_is_the_learner_alone() -> None:
    world = World(Sensed(system(0.01), {"state_0": 0.05, "state_1": 0.05}, delay=1))
    learner = learner_in(world, 1, filtered=True)
    both = trained(world, learner, seconds=5.0).learners
    alone = Training(learner, world, [5], Budget(seconds=5.0))
    alone.advance(10**6)
    for name in ("model", "policy", "fit", "observer"):
        mine, theirs = getattr(alone.learners, name), getattr(both, name)
        assert all(torch.equal(mine[k][0], theirs[k][1]) for k in theirs)


def test_refuses_a_filter_that_nothing_estimates_with() -> None:
    learner = learner_in(World(system()), 1, filtered=True)
    assert learner.observer is not None
    with pytest.raises(ValueError, match="observer: expected one with a filter"):
        replace(learner, observer=replace(learner.observer, filter=None))
