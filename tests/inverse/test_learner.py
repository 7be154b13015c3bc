"""Learning with an inverse model, in a world of known dynamics."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from edtorch.inverse.controller import InverseController
from edtorch.inverse.coordinates import JointCoordinates
from edtorch.inverse.features import INVERSE_FEATURES
from edtorch.inverse.layout import Layout
from edtorch.inverse.learner import InverseLearner, SampleWeight
from edtorch.inverse.policy import InversePolicy
from edtorch.inverse.unroll import InverseUnroll
from edtorch.model.fit import AbsoluteError
from edtorch.model.fit_ridge import Ridge
from edtorch.model.noise import LinearNoise, ResidualNoise
from edtorch.policy.steps import SaturatedStep
from edtorch.run.episodes import Budget
from edtorch.run.evaluation import evaluate
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.types import Transition
from edtorch.value.unroll import Horizon
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.inverse.arm import Masses


def _learner(features: str = "linear") -> InverseLearner:
    layout = Layout(Masses().spec)
    policy = InversePolicy(layout)
    controller = InverseController(
        policy, INVERSE_FEATURES[features](layout), JointCoordinates(layout)
    )
    unroll = InverseUnroll(policy, Horizon(25, 0.05, 1.0, 0.05))
    return InverseLearner(controller, unroll, Ridge(), SaturatedStep(0.5, 0.1), exploration=0.1)


def _train(seeds: list[int], seconds: float, features: str = "linear") -> Training:
    training = Training(_learner(features), World(Masses()), seeds, Budget(seconds=seconds))
    training.advance(10**9)
    return training


def _errors(training: Training) -> list[float]:
    learner = training.learner
    parameters = learner.acting(training.learners)
    fresh = evaluate(learner.policy, parameters, World(Masses()), training.seeds, 50)
    return [sum(e.measures["joint_error_rad"] for e in own) / len(own) for own in fresh]


@pytest.mark.oracle
def test_half_a_minute_of_learning_brings_the_joints_to_the_goal() -> None:
    before, after = _errors(_train([3], 0.02)), _errors(_train([3], 30.0))
    assert before[0] > 0.3
    assert after[0] < 0.25 * before[0]


@pytest.mark.oracle
@pytest.mark.parametrize("features", ["linear", "structured"])
def test_the_inverse_model_predicts_the_action_that_acted(features: str) -> None:
    training = _train([0], 60.0, features)
    controller = training.learner.policy
    assert isinstance(controller, InverseController)
    state = Masses().initial(torch.rand(200, 10, dtype=torch.float64))
    action = 2 * torch.rand(200, 5, dtype=torch.float64) - 1
    moved = Masses().step(state, 2 * action, torch.full((200, 5), 0.5, dtype=torch.float64))
    acceleration = (moved - state)[:, 6:11] / 0.02
    phi = controller.features(state[:, :12], acceleration)
    predicted = phi @ training.learners.model["inverse"][0].mT
    # cos(q_1 + q_2) is no sum of sines and cosines of one angle each.
    tolerance = {"linear": 0.2, "structured": 0.03}[features]
    assert float((predicted - action).abs().mean()) < tolerance


def test_a_learner_does_in_a_population_what_it_does_alone() -> None:
    together, alone = _train([5, 6, 7], 6.0), _train([6], 6.0)
    for name in ("model", "policy"):
        many, one = getattr(together.learners, name), getattr(alone.learners, name)
        for key, tensor in one.items():
            torch.testing.assert_close(many[key][1], tensor[0], rtol=1e-9, atol=1e-9)
    assert bool(alone.learners.policy["weight"].any())


def test_the_same_seed_gives_the_same_digits() -> None:
    one, other = _train([1], 3.0), _train([1], 3.0)
    assert torch.equal(one.learners.policy["weight"], other.learners.policy["weight"])
    assert torch.equal(one.learners.model["inverse"], other.learners.model["inverse"])


def test_what_is_not_finite_or_not_valid_teaches_nothing() -> None:
    learner = _learner()
    state = learner.initial([0, 1])
    observation = torch.rand(2, 17, dtype=torch.float64)
    following = observation + 0.01
    following[0, 3] = torch.nan
    action = torch.rand(2, 5, dtype=torch.float64)
    valid = torch.tensor([True, False])
    transition = Transition(observation, action, following, torch.tensor(0.02), valid)
    for _ in range(50):
        state, metrics = learner.step(state, transition)
        assert metrics.finite[:, 1].all() and not metrics.finite[0, 0]
    assert state.tick.tolist() == [50, 0]
    assert not any(bool(p.any()) for p in (*state.model.values(), *state.policy.values()))
    assert all(bool(p.isfinite().all()) for p in (*state.fit.values(), *state.step.values()))


def test_a_fit_that_diverges_is_skipped_and_told() -> None:
    learner = replace(_learner(), fit=AbsoluteError(float("inf")))
    training = Training(learner, World(Masses()), [0], Budget(seconds=2.0))
    training.advance(10**9)
    assert not bool(training.finite[1, 0])
    assert bool(training.learners.model["inverse"].isfinite().all())


def test_the_weight_of_a_sample_falls_with_acceleration_and_speed() -> None:
    weight = SampleWeight(100.0, 10.0)
    speed = torch.tensor([[0.0, 0.0], [10.0, -1.0], [0.0, 0.0]])
    acceleration = torch.tensor([[0.0, 0.0], [0.0, 0.0], [0.0, -100.0]])
    assert weight(speed, acceleration).squeeze(-1).tolist() == [1.0, 0.5, 0.5]


def test_refuses_domains_without_a_goal() -> None:
    for sim in (Bicycle(), LinearSystem([[1.0]], [[1.0]])):
        with pytest.raises(ValueError, match="expected a domain with a goal"):
            Layout(sim.spec)


def test_the_noise_is_what_the_unroll_did_not_foresee() -> None:
    """nu~ = rate dt e e' dt after one tick; e: the accelerations, where the policy wants none."""
    policy = _learner().policy
    unroll = InverseUnroll(policy.policy, Horizon(25, 0.05, 1.0, 0.05), propagates_covariance=True)
    learner = replace(_learner(), unroll=unroll, noise=ResidualNoise(2.0))
    observation = torch.rand(1, 17, dtype=torch.float64)
    following = observation + 0.01 * torch.rand(1, 17, dtype=torch.float64)
    action, dt = torch.rand(1, 5, dtype=torch.float64), torch.tensor(0.02, dtype=torch.float64)
    transition = Transition(observation, action, following, dt, torch.tensor([True]))
    state, _ = learner.step(learner.initial([0]), transition)
    e = (following - observation)[0, 6:12] * 3.0 / dt
    torch.testing.assert_close(state.noise["nu"][0], 2.0 * dt * e.outer(e) * dt)


def test_learns_with_the_covariance() -> None:
    policy = _learner().policy
    unroll = InverseUnroll(policy.policy, Horizon(25, 0.05, 1.0, 0.05), propagates_covariance=True)
    learner = replace(_learner(), unroll=unroll, noise=ResidualNoise(1.0))
    training = Training(learner, World(Masses()), [3], Budget(seconds=15.0))
    training.advance(10**9)
    assert _errors(training)[0] < 0.2
    assert bool(training.finite.all())


def test_refuses_a_covariance_without_noise_and_noise_that_is_not_constant() -> None:
    policy = _learner().policy
    unroll = InverseUnroll(policy.policy, Horizon(25, 0.05, 1.0, 0.05), propagates_covariance=True)
    with pytest.raises(ValueError, match=r"^noise=None"):
        replace(_learner(), unroll=unroll)
    with pytest.raises(ValueError, match=r"^noise=LinearNoise"):
        replace(_learner(), unroll=unroll, noise=LinearNoise(1.0))
