"""The estimate of the value's error, and the two readings of the value."""

from __future__ import annotations

import statistics
from dataclasses import replace
from typing import cast

import pytest
import torch

from edtorch.learner.learner import Learner
from edtorch.model.features import Identity, Pairwise
from edtorch.model.fit import SquaredError
from edtorch.model.models import NextStateModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import PlainStep
from edtorch.rewards import QuadraticReward
from edtorch.transform import (
    ConstantNoise,
    Cubature,
    FirstOrder,
    GaussHermite,
    MeanOnly,
    Transform,
    point_belief,
)
from edtorch.types import Belief
from edtorch.value.choose import choose_path
from edtorch.value.error_estimate import ValueErrorIndicator, value_error_estimate
from edtorch.value.unroll import Generic, Horizon, Reading, propagate
from tests.smooth_systems import coupled_monte_carlo, random_system
from tests.systems import f64, normal, random_cost
from tests.transforms import transforms


def value(transform: Transform, horizon: Horizon, seed: int = 0) -> torch.Tensor:
    system = random_system(3, seed)
    spread = 0.1 * random_cost(torch.Generator().manual_seed(seed), 3)
    return propagate(
        Belief(system.start, spread),
        system.closed_loop,
        system.policy,
        reward=system.reward,
        transform=transform,
        noise=system.noise,
        horizon=horizon,
    ).value


@pytest.mark.parametrize("transform", transforms(3, mean_only=True))
@pytest.mark.parametrize("gamma", [0.9, 1.0])
@pytest.mark.parametrize("unit", [1.0, 0.05])
def test_definition_is_the_first_reward_and_the_discounted_figure(
    transform: Transform, gamma: float, unit: float
) -> None:
    present = value(transform, Horizon(0, 1.0, gamma, 1.0, "definition"))
    figure = value(transform, Horizon(4, 1.0, gamma, unit))
    definition = value(transform, Horizon(4, 1.0, gamma, unit, "definition"))
    assert torch.allclose(definition, unit * present + gamma**unit * figure, rtol=1e-12)


def test_no_step_leaves_the_present_reward_to_the_definition_and_nothing_to_the_figure() -> None:
    system = random_system(3, 0)
    path = propagate(
        point_belief(system.start),
        system.closed_loop,
        system.policy,
        reward=system.reward,
        transform=FirstOrder(),
        noise=system.noise,
        horizon=Horizon(0, 1.0, 0.5, 1.0, "definition"),
    )
    assert path.mean.shape == (1, 3) and path.reward.shape == (1,)
    assert torch.allclose(path.value, system.state_reward(system.start), rtol=1e-14)
    with pytest.raises(ValueError, match="horizon=0"):
        Horizon(0, 1.0, 0.5, 1.0, "figure")
    with pytest.raises(ValueError, match="horizon=-1"):
        Horizon(-1, 1.0, 0.5, 1.0, "definition")


@pytest.mark.parametrize(("reading", "count"), [("figure", 7), ("definition", 8)])
def test_weights_by_reading(reading: Reading, count: int) -> None:
    # Without discount the weights add up to Theorem 4's n + 1 terms, or Figure 1's n.
    assert sum(Horizon(7, 1.0, 1.0, 1.0, reading).weights()) == count
    geometric = (1 - 0.9**count) / (1 - 0.9)
    assert sum(Horizon(7, 1.0, 0.9, 1.0, reading).weights()) == pytest.approx(geometric, rel=1e-14)


def test_an_unknown_reading_is_refused() -> None:
    with pytest.raises(ValueError, match="reading=paper: expected one of figure, definition"):
        Horizon(7, 1.0, 1.0, 1.0, cast(Reading, "paper"))


def test_the_closed_form_leaves_the_definition_to_the_generic_path() -> None:
    model = NextStateModel(1, 1, Identity(2), torch.zeros(1).double())
    reward = QuadraticReward(f64([[1.0]]), f64([[0.0]]))
    horizon = Horizon(3, 1.0, 1.0, 1.0, "definition")
    policy = LinearPolicy(1, 1, Identity(1))
    choice = choose_path("auto", model, policy, reward, MeanOnly(), horizon)
    assert isinstance(choice.path, Generic) and "present state" in choice.reason


@pytest.mark.oracle
def test_the_estimate_is_the_error_under_mild_nonlinearity() -> None:
    """Against Gaussian moment matching, near enough to the truth where noise is mild."""
    ratios = []
    for seed in range(12):
        system = random_system(2, seed, v0=0.02)
        horizon = Horizon(10, 1.0, 0.95, 1.0)
        start = point_belief(system.start)

        def run(transform: Transform, system=system, start=start, horizon=horizon) -> float:
            return float(
                propagate(
                    start,
                    system.closed_loop,
                    system.policy,
                    reward=system.reward,
                    transform=transform,
                    noise=system.noise,
                    horizon=horizon,
                ).value
            )

        estimate = value_error_estimate(
            start,
            system.closed_loop,
            system.policy,
            reward=system.reward,
            noise=system.noise,
            horizon=horizon,
        )
        ratios.append(float(estimate) / (run(GaussHermite(5)) - run(FirstOrder())))
    assert 0.8 <= statistics.median(ratios) <= 1.25


@pytest.mark.oracle
def test_cubature_is_nearer_to_the_truth_than_the_first_order() -> None:
    """Against coupled Monte Carlo: the median over systems of the value's error."""
    gains, deviations = [], []
    for seed in range(9):
        system = random_system(2, seed)
        truth = coupled_monte_carlo(system, 40_000, torch.Generator().manual_seed(seed))
        values = {}
        for transform in (FirstOrder(), Cubature(), GaussHermite(5)):
            values[type(transform)] = propagate(
                point_belief(system.start),
                system.closed_loop,
                system.policy,
                reward=system.reward,
                transform=transform,
                noise=system.noise,
                horizon=Horizon(system.horizon, 1.0, system.discount, 1.0),
            ).value
        errors = {kind: float((v - truth.value).abs()) for kind, v in values.items()}
        gains.append(errors[FirstOrder] / errors[Cubature])
        deviations.append(errors[GaussHermite] / float(truth.value_error))
    assert statistics.median(gains) > 5
    # Moment matching is not the truth, but at this noise it is so within a few standard errors.
    assert statistics.median(deviations) < 4


def test_indicator_of_a_population_is_the_estimate_of_each_learner() -> None:
    model = NextStateModel(2, 1, Pairwise(3), torch.zeros(2, dtype=torch.float64))
    policy = LinearPolicy(2, 1, Identity(2))
    reward = QuadraticReward(torch.eye(2).double(), torch.zeros(1, 1).double())
    horizon, rule = Horizon(4, 1.0, 0.9, 1.0), ResidualNoise(1.0)
    start_cov = 0.01 * torch.eye(2).double()
    generic = Generic(model, policy, reward, FirstOrder(), horizon, rule, start_cov)
    path = choose_path("auto", model, policy, reward, FirstOrder(), horizon, noise=rule).path
    learner = Learner(model, policy, SquaredError(0.1), rule, path, PlainStep(0.1), 0.0)
    g = torch.Generator().manual_seed(0)
    learners = replace(
        learner.initial([0, 1]),
        model={"weight": 0.3 * normal(g, 2, 2, model.features.outputs)},
        policy={"weight": 0.3 * normal(g, 2, 1, 2)},
        noise={"nu": random_cost(g, 2).expand(2, 2, 2)},
    )
    state = normal(g, 2, 2)
    with torch.inference_mode():
        lived = state * 1.0
    together = ValueErrorIndicator(generic)(learners, lived)
    assert bool((together != 0).all())
    for b in range(2):
        loop = generic.loop(
            {"weight": learners.model["weight"][b]}, {"weight": learners.policy["weight"][b]}
        )
        alone = value_error_estimate(
            Belief(state[b], start_cov),
            loop,
            loop.act,
            reward=reward,
            noise=ConstantNoise(learners.noise["nu"][b]),
            horizon=horizon,
        )
        assert float(together[b]) == pytest.approx(float(alone), rel=1e-10)
