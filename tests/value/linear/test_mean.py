"""The closed form for linear loops equals the generic path, and the recursions what they stand
for."""

from __future__ import annotations

import pytest
import torch

from edtorch.model.features import Affine, Identity
from edtorch.value.linear.mean import (
    adjoint_states,
    forward_states,
    powers_of_two,
)
from tests.systems import Features, linear_case, normal, same_value_and_gradient

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
    same_value_and_gradient(case.closed(*arguments), case.generic(*arguments))


@pytest.mark.oracle
@pytest.mark.parametrize("features", [(Affine, Identity), (Identity, Affine), (Affine, Affine)])
def test_constant_terms_are_states_that_stay_one(
    features: tuple[Features, Features],
) -> None:
    case = linear_case(4, 2, 9, action_cost=True, features=features)
    arguments = (case.model, case.policy, case.noise, case.state)
    same_value_and_gradient(case.closed(*arguments), case.generic(*arguments))


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
