"""Targets, cross and linear terms: the closed form of the value equals the generic path."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Affine, Identity
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import BayesianNoise, Noise, ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import PhysicalReward, QuadraticReward
from edtorch.transform import Cubature, FirstOrder, MeanOnly, Transform
from edtorch.value.choose import choose_path
from edtorch.value.unroll import Generic, Horizon
from tests.systems import normal, random_cost, same_value_and_gradient

N, M, B = 3, 2, 4


def parts(g: torch.Generator) -> dict[str, Tensor]:
    both = random_cost(g, N + M)
    return {
        "state_cost": both[:N, :N].clone(),
        "action_cost": both[N:, N:].clone(),
        "cross": both[:N, N:].clone(),
        "target": normal(g, N),
        "action_target": normal(g, M),
        "state_linear": normal(g, N),
        "action_linear": normal(g, M),
    }


def reward_with(*names: str) -> QuadraticReward:
    given: dict[str, Any] = parts(torch.Generator().manual_seed(0))
    costs = given.pop("state_cost"), given.pop("action_cost")
    return QuadraticReward(*costs, **{name: given[name] for name in names})


def test_by_hand() -> None:
    one = torch.ones(1, 1).double()
    reward = QuadraticReward(
        2 * one,
        3 * one,
        target=one[0],
        action_target=2 * one[0],
        cross=one,
        state_linear=5 * one[0],
        action_linear=7 * one[0],
    )
    found = reward(torch.tensor([[4.0]]).double(), torch.tensor([[1.0]]).double())
    # Deviations 3 and -1: 2 * 9 + 3 * 1 - 2 * 3 + 5 * 4 + 7 * 1.
    assert found.tolist() == [-(18 + 3 - 6 + 20 + 7)]


EVERYTHING = ("target", "action_target", "cross", "state_linear", "action_linear")
CASES = [("target",), ("cross",), ("state_linear",), ("action_target", "action_linear"), EVERYTHING]


@pytest.mark.parametrize("names", CASES)
def test_the_form_is_the_reward_multiplied_out(names: tuple[str, ...]) -> None:
    g = torch.Generator().manual_seed(1)
    reward, s, a = reward_with(*names), normal(g, B, N), normal(g, B, M)
    form = reward.quadratic_form
    x = torch.cat([torch.ones(B, 1).double(), s], -1)
    cost = (x @ form.of_state * x).sum(-1) + (a @ form.action * a).sum(-1)
    cost = cost + 2 * (x @ form.of_both * a).sum(-1)
    assert torch.allclose(reward(s, a), -cost, rtol=1e-12)
    # The same in other units.
    by_state, by_action = torch.rand(N).double() + 0.5, torch.rand(M).double() + 0.5
    other = PhysicalReward(reward, by_state, by_action).quadratic_form
    assert other is not None
    z = torch.cat([torch.ones(B, 1).double(), s / by_state], -1)
    u = a / by_action
    cost = (z @ other.of_state * z).sum(-1) + (u @ other.action * u).sum(-1)
    cost = cost + 2 * (z @ other.of_both * u).sum(-1)
    assert torch.allclose(reward(s, a), -cost, rtol=1e-12)


@pytest.mark.parametrize("names", CASES)
@pytest.mark.parametrize("features", [(Identity, Identity), (Affine, Identity), (Identity, Affine)])
@pytest.mark.parametrize(
    ("transform", "noise"),
    [
        (MeanOnly(), None),
        (FirstOrder(), ResidualNoise(1.0)),
        (FirstOrder(), BayesianNoise(1.0, 2.0)),
        (Cubature(), BayesianNoise(1.0, 2.0)),
    ],
)
def test_closed_form_equals_generic(
    names: tuple[str, ...], features: tuple[Any, Any], transform: Transform, noise: Noise | None
) -> None:
    g = torch.Generator().manual_seed(2)
    model = DerivativeModel(N, M, features[0](N + M), torch.zeros(N).double())
    policy = LinearPolicy(N, M, features[1](N))
    horizon = Horizon(4, 0.05, 0.9, 0.05)
    start = random_cost(g, N)
    choice = choose_path(
        "closed_form",
        model,
        policy,
        reward_with(*names),
        transform,
        horizon,
        noise=noise,
        start_cov=start,
    )
    assert not isinstance(choice.path, Generic)
    k = model.regressors
    memory = {"nu": random_cost(g, N).expand(B, N, N).clone()}
    memory["P"] = random_cost(g, k).expand(B, k, k).clone()
    given = (
        {"weight": normal(g, B, N, k)},
        {"weight": normal(g, B, M, policy.features.outputs)},
        memory,
        normal(g, B, N),
    )
    tolerance = 1e-6 if isinstance(transform, Cubature) else 1e-10
    same_value_and_gradient(choice.path(*given), choice.generic(*given), tolerance)
    # What a compiler gets is the same as well, where there is such a form.


def test_refuses_a_cross_term_that_can_outgrow_the_squares() -> None:
    one = torch.ones(1, 1).double()
    with pytest.raises(ValueError, match="with cross has eigenvalue -1"):
        QuadraticReward(one, one, cross=2 * one)
    with pytest.raises(ValueError, match=r"target has shape \(2,\), expected \(1,\)"):
        QuadraticReward(one, one, target=torch.zeros(2).double())
