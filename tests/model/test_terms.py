"""Sets of terms: their counts, their rank, their derivatives."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
import torch

from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from tests.cart_poles import spec, told


def chain(angles: int, positions: int = 0, actions: int = 1) -> Told:
    """Angles and invariant positions, each with its rate."""
    names = [f"q{i}" for i in range(positions + angles)]
    return Told(
        names=(*names, *(f"d{name}" for name in names)),
        unit=(1.0,) * 2 * len(names),
        angle=(False,) * positions + (True,) * angles + (False,) * len(names),
        rate_of=(-1,) * len(names) + tuple(range(len(names))),
        actions=tuple(f"u{k}" for k in range(actions)),
        invariant=frozenset(names[:positions]),
    )


@pytest.mark.parametrize(
    ("angles", "positions", "count"),
    [(1, 1, 37), (2, 0, 93), (2, 1, 146)],
    ids=["cart-pole", "pendubot", "cart-double-pendulum"],
)
def test_implicit_counts(angles: int, positions: int, count: int) -> None:
    """(1 + 2 a + C(2 a + 1, 2) - a) trigonometric monomials, times 1, u, v_i v_j and f_j; and v."""
    given = chain(angles, positions)
    terms = Terms.implicit(given, Lift.of(given))
    rates = angles + positions
    trig = comb(2 * angles + 2, 2) - angles
    assert terms.count == trig * (2 + comb(rates + 1, 2) + rates) + rates == count


def test_counts_of_series_and_of_monomials() -> None:
    seen = Told.of(spec())  # the position of the cart is not told to be invariant
    lift = Lift.of(seen)
    assert Terms.products(seen, lift).count == 50
    assert Terms.monomials(seen, lift).count == comb(10, 4) - comb(8, 2) == 182
    assert Terms.implicit(seen, lift).count == 38
    assert Terms.monomials(told(), lift, degree=1).count == 6


@pytest.mark.parametrize("kind", ["implicit", "products", "monomials"])
def test_terms_are_independent_and_know_nothing_of_what_is_left_out(kind: str) -> None:
    given = told()
    lift = Lift.of(given)
    terms = getattr(Terms, kind)(given, lift)
    assert not (terms.factors == lift.entry("position")).any()
    keys = [
        (j, *sorted(row)) for j, row in zip(terms.derivative, terms.factors.tolist(), strict=True)
    ]
    assert len(set(keys)) == terms.count
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(400, 5, generator=generator, dtype=torch.float64)
    plain = terms(lift(rows[:, :4], rows[:, 4:]))[:, torch.from_numpy(terms.derivative < 0)]
    assert int(torch.linalg.matrix_rank(plain / plain.norm(dim=0))) == plain.shape[1]


def test_first_order_states_enter_as_rates_do() -> None:
    """A tank: nothing is told, so that each state's own derivative is learned."""
    tank = Told(("h", "g"), (1.0, 1.0), (False, False), (-1, -1), ("u",))
    lift = Lift.of(tank)
    terms = Terms.products(tank, lift)
    found = {tuple(sorted(lift.names[k] for k in row if k)) for row in terms.factors.tolist()}
    assert found == {(), ("h",), ("g",), ("h", "h"), ("g", "h"), ("g", "g"), ("u",)}


def test_values_and_jacobian() -> None:
    lift = Lift.of(told())
    terms = Terms(np.array([[0, 0], [2, 0], [2, 2], [5, 3]]), np.array([-1, -1, -1, -1]))
    generator = torch.Generator().manual_seed(0)
    A = torch.randn(3, lift.size, generator=generator, dtype=torch.float64)
    slope = torch.randn(3, lift.size, 2, generator=generator, dtype=torch.float64)
    A[:, 0], slope[:, 0] = 1.0, 0.0  # the entry that pads
    a, b, c = A[:, 2], A[:, 5], A[:, 3]
    torch.testing.assert_close(terms(A), torch.stack([torch.ones_like(a), a, a * a, b * c], -1))
    da, db, dc = slope[:, 2], slope[:, 5], slope[:, 3]
    a, b, c = a[:, None], b[:, None], c[:, None]
    expected = torch.stack([0 * da, da, 2 * a * da, b * dc + c * db], -2)
    torch.testing.assert_close(terms.jacobian(A, slope), expected)


def test_refuses_a_negative_degree() -> None:
    with pytest.raises(ValueError, match=r"degree=-1: expected 0 or more"):
        Terms.products(told(), Lift.of(told()), degree=-1)
