"""The closed form for linear loops equals the generic path, and the recursions what they stand
for."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Affine, Identity
from edtorch.value.linear.mean import (
    adjoint_states,
    forward_states,
    mean_value_and_gradient,
    powers_of_two,
)
from edtorch.value.linear.recursion import mean_by_recursion
from tests.systems import Features, linear_case, normal, random_cost, same_value_and_gradient

SIZES = [
    (5, 2, 30),
    (5, 2, 1),
    (5, 2, 2),
    (5, 2, 3),
    (7, 3, 17),
    (4, 1, 64),
    (14, 5, 33),
    (1, 1, 5),
]


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "m", "steps"), SIZES)
@pytest.mark.parametrize("action_cost", [False, True])
def test_equals_the_generic_path(n: int, m: int, steps: int, action_cost: bool) -> None:
    case = linear_case(n, m, steps, action_cost=action_cost)
    arguments = (case.model, case.policy, case.noise, case.state)
    for path in (case.closed, case.compiled):
        same_value_and_gradient(path(*arguments), case.generic(*arguments))


@pytest.mark.oracle
@pytest.mark.parametrize("features", [(Affine, Identity), (Identity, Affine), (Affine, Affine)])
def test_constant_terms_are_states_that_stay_one(
    features: tuple[Features, Features],
) -> None:
    case = linear_case(4, 2, 9, action_cost=True, features=features)
    arguments = (case.model, case.policy, case.noise, case.state)
    for path in (case.closed, case.compiled):
        same_value_and_gradient(path(*arguments), case.generic(*arguments))


def test_increments_keep_digits_in_single_precision() -> None:
    g = torch.Generator().manual_seed(0)
    # Slow, as 0.051 s of the bicycle are: where I + D is rounded, D loses digits.
    drift, G, theta = 0.03 * normal(g, 256, 5, 5), 0.03 * normal(g, 256, 5, 2), normal(g, 256, 2, 5)
    start, cost = normal(g, 256, 5), random_cost(g, 5)
    weights = [0.051] * 30

    def gradients(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        system = [x.to(dtype) for x in (drift, G, theta, start)]
        costs = {"state_cost": cost.to(dtype), "action_cost": None}
        doubled = mean_value_and_gradient(*system, **costs, weights=torch.tensor(weights).to(dtype))
        stepped = mean_by_recursion(*system, **costs, weights=weights)
        return doubled[1], stepped[1]

    exact = gradients(torch.float64)[0]
    errors = [
        float(
            ((g.double() - exact).flatten(1).norm(dim=-1) / exact.flatten(1).norm(dim=-1)).median()
        )
        for g in gradients(torch.float32)
    ]
    assert errors[1] < 1e-6 and errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize("steps", [1, 2, 3, 4, 7, 8, 9, 30, 31, 32, 33])
def test_doubling_equals_stepping(steps: int) -> None:
    g = torch.Generator().manual_seed(steps)
    A, start, q = 0.7 * normal(g, 2, 3, 3), normal(g, 2, 3), normal(g, 2, 3, steps)
    powers = powers_of_two(A, steps)
    states = [start]
    for _ in range(steps):
        states.append((A @ states[-1].unsqueeze(-1)).squeeze(-1))
    assert torch.allclose(forward_states(powers, start, steps), torch.stack(states, -1), rtol=1e-10)
    carried, adjoints = torch.zeros(2, 3).double(), []
    for tau in reversed(range(steps)):
        carried = q[..., tau] + (A.mT @ carried.unsqueeze(-1)).squeeze(-1)
        adjoints.insert(0, carried)
    assert torch.allclose(adjoint_states(powers, q), torch.stack(adjoints, -1), rtol=1e-10)


def test_digits_do_not_depend_on_the_company() -> None:
    case = linear_case(5, 2, 30, batch=9)
    together = case.closed(case.model, case.policy, case.noise, case.state)
    for b in range(9):
        one = slice(b, b + 1)
        alone = case.closed(
            {"weight": case.model["weight"][one].clone()},
            {"weight": case.policy["weight"][one].clone()},
            {},
            case.state[one].clone(),
        )
        assert torch.equal(alone.value, together.value[one])
        assert torch.equal(alone.gradient["weight"], together.gradient["weight"][one])
