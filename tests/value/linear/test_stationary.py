"""The regulator about a named equilibrium of a mechanism's model."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure, runge_kutta
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from edtorch.value.linear.lqr import NotConverged, stationary_lqr
from edtorch.value.linear.stationary import NoEquilibrium, regulator_at, standing
from tests.cart_poles import DT, moved, structure, told, true_weight

ZERO, UNIT = torch.zeros(1, dtype=torch.float64), torch.ones(1, dtype=torch.float64)


def _mass(invariant: str = "", **coefficients: float) -> tuple[Structure, Tensor]:
    """x'' = a sum of ``coefficients`` times "1", x, v and u; the scale of v is 2 m/s."""
    given = Told(
        ("x", "v"), (1.0, 2.0), (False, False), (-1, 0), ("u",), invariant=frozenset(invariant)
    )
    lift = Lift.of(given)
    built = Structure.of(given, lift, Terms.monomials(given, lift, 1))
    names = [lift.names[row[0]] for row in built.terms.factors]
    values = {"one": "1", "x": "x", "v": "v", "u": "u"}
    weight = torch.zeros(1, built.terms.count, dtype=torch.float64)
    for key, value in coefficients.items():
        weight[0, names.index(values[key])] = value
    return built, weight


def _state(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _rows(built: Structure, **weights: float) -> Tensor:
    rows = torch.zeros(len(weights), built.lift.size, dtype=torch.float64)
    for row, (name, weight) in zip(rows, weights.items(), strict=True):
        row[built.lift.entry(name.replace("_", " "))] = weight
    return rows


def test_a_linear_system_has_the_regulator_of_its_exact_tick() -> None:
    """An oscillator: the tick is a matrix exponential, up to Runge and Kutta's error."""
    built, weight = _mass(x=-2.0, v=-0.3, u=1.5)
    found = regulator_at(
        built, weight, _state(0.2, 0.0), torch.tensor([True, False]), ZERO, 2 * UNIT, 0.05,
        _rows(built, x=1.0, v=0.5), 0.4 * UNIT,
    )  # fmt: skip
    # (s, u) with u constant during the tick; dx/dt = 2 v.
    whole = torch.tensor([[0.0, 2.0, 0.0], [-2.0, -0.3, 1.5], [0.0, 0.0, 0.0]]).double()
    tick = torch.linalg.matrix_exp(0.05 * whole)
    Q, R = torch.diag(_state(1.0, 0.25)), torch.diag(0.4 * UNIT / 4)
    gain, cost = stationary_lqr(tick[:2, :2], tick[:2, 2:], Q, R)
    assert_close(found.gain, gain, rtol=1e-6, atol=1e-8)
    assert_close(found.cost, cost, rtol=1e-6, atol=1e-8)
    assert_close(found.state, _state(0.2, 0.0), rtol=0, atol=1e-6)
    assert_close(found.action, _state(0.2 * 2.0 / 1.5), rtol=0, atol=1e-6)


def test_holds_the_true_cart_and_pole_upright() -> None:
    built = structure(told())
    rows = _rows(built, position=1.0, sin_angle=0.5)
    found = regulator_at(
        built, true_weight(built), _state(0.3, 0.1, 0.2, 0.1),
        torch.tensor([True, False, False, False]), ZERO, UNIT, DT, rows, 0.1 * UNIT,
    )  # fmt: skip
    assert_close(found.state, _state(0.3, 0.0, 0.0, 0.0), rtol=0, atol=1e-6)
    unit = torch.tensor(told().unit, dtype=torch.float64)
    state = unit * _state(0.0, 0.0, 0.1, 0.0)
    for _ in range(100):
        action = found.action + found.gain @ (state / unit - found.state)
        state = moved(state, 10 * action)
    assert_close(state / unit, found.state, rtol=0, atol=1e-4)


def test_a_position_that_nothing_depends_on_may_drift() -> None:
    """At a cruising speed of 0.8 (1.6 m/s) the action balances friction."""
    built, weight = _mass(invariant="x", v=-0.5, u=2.0)
    held = torch.tensor([False, True])
    state, action = standing(built, weight, _state(0.0, 0.8), held, ZERO, UNIT)
    assert_close(action, _state(0.2), rtol=0, atol=1e-6)
    after = runge_kutta(built, weight, state, action, 1.0)
    assert_close(after, _state(1.6, 0.8), rtol=0, atol=1e-6)
    with pytest.raises(NoEquilibrium, match=r"'x' moves by 1.6 a second") as error:
        standing(built, weight, _state(0.0, 0.8), torch.tensor([True, True]), ZERO, UNIT)
    assert "\n" not in str(error.value)


def test_a_pole_is_not_held_beside_upright_by_a_cart_that_stands() -> None:
    """Only a cart that accelerates carries a leaning pole: u = (M + m) g tan q moves its speed."""
    built = structure(told())
    held = torch.tensor([False, False, True, False])
    with pytest.raises(NoEquilibrium, match=r"expected targets that the actions can hold"):
        standing(built, true_weight(built), _state(0, 0, 0.3, 0), held, ZERO, UNIT)


def test_beyond_the_range_of_the_actions() -> None:
    built, weight = _mass(one=-1.0, u=2.0)
    held = torch.tensor([True, False])
    _, action = standing(built, weight, _state(0.0, 0.0), held, ZERO, UNIT)
    assert math.isclose(float(action), 0.5, abs_tol=1e-6)
    with pytest.raises(NoEquilibrium, match=r"'v' moves by -0.2 a second"):
        standing(built, weight, _state(0.0, 0.0), held, ZERO, 0.4 * UNIT)


def test_what_no_action_stabilises_is_said() -> None:
    built, weight = _mass(x=2.0)
    with pytest.raises(NotConverged, match=r"cannot be stabilised"):
        regulator_at(
            built, weight, _state(0.0, 0.0), torch.tensor([True, False]), ZERO, UNIT, 0.1,
            _rows(built, x=1.0), UNIT,
        )  # fmt: skip
