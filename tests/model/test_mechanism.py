"""The implicit model of a mechanism against its physics, and its derivatives."""

from __future__ import annotations

import math

import pytest
import torch
from torch.func import jacrev, vmap

from edtorch.model.lift import Lift
from edtorch.model.mechanism import (
    Structure,
    accelerations,
    derivative_jacobian,
    runge_kutta,
    runge_kutta_jacobian,
    state_derivative,
)
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from tests.cart_poles import structure, told, true_derivative, true_weight


def _rows(count: int = 50) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    both = torch.randn(count, 5, generator=generator, dtype=torch.float64)
    return 2 * both[:, :4], both[:, 4:]


def _random_weight(built: Structure, batch: tuple[int, ...] = ()) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    shape = (*batch, len(built.learned), built.terms.count)
    return 0.1 * torch.randn(shape, generator=generator, dtype=torch.float64) * built.allowed


@pytest.mark.parametrize("scales", [{}, {"speed": 1.0, "rate": 0.5, "position": 7.0}])
def test_a_mechanism_is_in_the_span(scales: dict[str, float]) -> None:
    """Six weights are the cart-pole exactly, whose accelerations are fractions in cos^2."""
    given = told(**scales)
    built, (state, action) = structure(given), _rows()
    found = state_derivative(built, true_weight(built), state, action)
    expected = true_derivative(given, state, action)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", ["implicit", "products", "monomials"])
def test_jacobian_is_that_of_automatic_differentiation(kind: str) -> None:
    built, (state, action) = structure(told(), kind), _rows(8)
    weight = _random_weight(built)

    def derivative(s: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return state_derivative(built, weight, s, u)

    expected = torch.cat(vmap(jacrev(derivative, argnums=(0, 1)))(state, action), dim=-1)
    found = derivative_jacobian(built, weight, state, action)
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-10)


def test_accelerations_solve_their_equations() -> None:
    built, (state, action) = structure(told()), _rows()
    weight = _random_weight(built)
    f = accelerations(built, weight, state, action)
    phi = built.terms(built.lift(state, action))
    kind = torch.from_numpy(built.terms.derivative)
    factor = torch.cat([torch.ones_like(f[:, :1]), f], -1)[:, kind + 1]
    torch.testing.assert_close((phi * factor) @ weight.mT, f, rtol=1e-9, atol=1e-9)


def test_each_row_may_have_weights_of_its_own() -> None:
    built, (state, action) = structure(told()), _rows(5)
    weight = _random_weight(built, (5,))
    for function in (accelerations, state_derivative, derivative_jacobian):
        each = [function(built, w, s, u) for w, s, u in zip(weight, state, action, strict=True)]
        torch.testing.assert_close(function(built, weight, state, action), torch.stack(each))


def test_runge_kutta_is_of_fourth_order() -> None:
    built, (state, action) = structure(told()), _rows(20)
    weight = true_weight(built)
    fine = runge_kutta(built, weight, state, action, 0.1, steps=100)
    errors = [
        float((runge_kutta(built, weight, state, action, 0.1, steps) - fine).abs().max())
        for steps in (4, 8, 16)
    ]
    assert errors[2] < 1e-4
    assert math.log2(errors[0] / errors[1]) > 3.5 and math.log2(errors[1] / errors[2]) > 3.5


def test_jacobian_of_a_tick_is_that_of_automatic_differentiation() -> None:
    built, (state, action) = structure(told()), _rows(4)
    weight, seconds = true_weight(built), torch.tensor([0.02, 0.1, 0.05, 0.1]).double()

    def tick(s: torch.Tensor, u: torch.Tensor, dt: torch.Tensor) -> torch.Tensor:
        return runge_kutta(built, weight, s, u, dt, steps=3)

    by_state, by_action = vmap(jacrev(tick, argnums=(0, 1)))(state, action, seconds)
    found = runge_kutta_jacobian(built, weight, state, action, seconds, steps=3)
    expected = torch.cat([by_state, by_action], dim=-1)
    torch.testing.assert_close(found, expected, rtol=1e-11, atol=1e-12)


def test_seconds_of_each_row() -> None:
    built, (state, action) = structure(told()), _rows(3)
    weight, seconds = true_weight(built), torch.tensor([0.02, 0.1, 0.05], dtype=torch.float64)
    together = runge_kutta(built, weight, state, action, seconds)
    for i, dt in enumerate(seconds):
        alone = runge_kutta(built, weight, state[i], action[i], dt)
        torch.testing.assert_close(together[i], alone, rtol=1e-13, atol=1e-13)


def test_constant_and_ignored_components_stay() -> None:
    given = Told(
        names=("x", "v", "goal", "noise"),
        unit=(1.0,) * 4,
        angle=(False,) * 4,
        rate_of=(-1, 0, -1, -1),
        actions=("u",),
        constant=frozenset({"goal"}),
        ignored=frozenset({"noise"}),
    )
    lift = Lift.of(given)
    built = Structure.of(given, lift, Terms.products(given, lift))
    state, action = _rows(4)
    weight = _random_weight(built)
    moved = runge_kutta(built, weight, state, action, 0.3)
    assert torch.equal(moved[:, 2:], state[:, 2:]) and not (moved[:, :2] == state[:, :2]).any()
    assert torch.equal(state_derivative(built, weight, state, action)[:, 0], state[:, 1])
    other = state.clone()
    other[:, 3] += 1
    assert torch.equal(runge_kutta(built, weight, other, action, 0.3)[:, :2], moved[:, :2])


def test_differences_take_the_short_way_round() -> None:
    given = Told(("q", "x"), (2.0, 1.0), (True, False), (-1, -1), ())
    lift = Lift.of(given)
    built = Structure.of(given, lift, Terms.products(given, lift))
    start = torch.tensor([1.5, 3.0], dtype=torch.float64)  # 3 rad
    end = torch.tensor([-1.5, -3.0], dtype=torch.float64)
    expected = torch.tensor([math.pi - 3.0, -6.0], dtype=torch.float64)
    torch.testing.assert_close(built.difference(end, start), expected)
