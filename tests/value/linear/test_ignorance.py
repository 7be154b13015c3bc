"""Bayesian noise in closed form equals the generic path, at the mean and averaged."""

from __future__ import annotations

import pytest
import torch

from edtorch.model.features import Affine, Identity
from edtorch.model.noise import BayesianNoise, ResidualNoise
from edtorch.transform import Cubature, FirstOrder, SecondOrder, Transform
from edtorch.value.choose import choose_path
from edtorch.value.linear import LinearIgnorance, LinearMoment
from tests.systems import Features, LinearCase, linear_case, random_cost, same_value_and_gradient


@pytest.mark.oracle
@pytest.mark.parametrize("transform", [FirstOrder(), SecondOrder(), Cubature()])
@pytest.mark.parametrize(("n", "m", "steps"), [(1, 1, 1), (3, 2, 2), (5, 2, 9)])
@pytest.mark.parametrize("action_cost", [False, True])
def test_equals_the_generic_path(
    n: int, m: int, steps: int, action_cost: bool, transform: Transform
) -> None:
    check_paths(linear_case(n, m, steps, action_cost=action_cost), n, transform)


@pytest.mark.oracle
@pytest.mark.parametrize("transform", [FirstOrder(), Cubature()])
@pytest.mark.parametrize("features", [(Affine, Identity), (Identity, Affine), (Affine, Affine)])
def test_constant_terms_are_states_that_stay_one(
    features: tuple[Features, Features], transform: Transform
) -> None:
    check_paths(linear_case(3, 2, 5, action_cost=True, features=features), 3, transform)


def check_paths(case: LinearCase, n: int, transform: Transform) -> None:
    """The closed form against the generic path, with a start belief."""
    g = torch.Generator().manual_seed(0)
    k = case.generic.model.regressors
    noise = {
        "nu": random_cost(g, n).expand(3, n, n).clone(),
        "P": random_cost(g, k).expand(3, k, k).clone(),
    }
    old = case.generic
    choice = choose_path(
        "closed_form",
        old.model,
        old.policy,
        old.reward,
        transform,
        old.horizon,
        noise=BayesianNoise(1.0, stretch=3.0),
        start_cov=random_cost(g, n),
    )
    assert isinstance(choice.path, LinearIgnorance) and "does not know" in choice.reason
    arguments = (case.model, case.policy, noise, case.state)
    same_value_and_gradient(choice.path(*arguments), choice.generic(*arguments), 1e-9)


@pytest.mark.parametrize("transform", [FirstOrder(), Cubature()])
def test_a_model_that_knows_everything_has_constant_noise(transform: Transform) -> None:
    case = linear_case(4, 2, 6)
    g = torch.Generator().manual_seed(1)
    nu = random_cost(g, 4).expand(3, 4, 4).clone()
    old, results = case.generic, []
    for rule, memory in (
        (BayesianNoise(1.0), {"nu": nu, "P": torch.zeros(3, 6, 6).double()}),
        (ResidualNoise(1.0), {"nu": nu}),
    ):
        path = choose_path(
            "auto", old.model, old.policy, old.reward, transform, old.horizon, noise=rule
        ).path
        assert isinstance(path, LinearIgnorance | LinearMoment)
        results.append(path(case.model, case.policy, memory, case.state))
    assert torch.allclose(results[0].value, results[1].value, rtol=1e-12)
    assert torch.allclose(
        results[0].gradient["weight"], results[1].gradient["weight"], rtol=1e-9, atol=1e-12
    )
