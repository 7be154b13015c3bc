"""The compiled mechanism model against the one of torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.func import jacrev

from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure, derivative_jacobian, runge_kutta, state_derivative
from edtorch.model.terms import Terms
from edtorch.search.program import kernels
from edtorch.search.tick_model import TickModel, product_tree
from tests import cart_poles
from tests.planning import swing_up, tick_once


def _models() -> list[TickModel]:
    """The true cart-pole; any weights, any scales, implicit, explicit and of monomials."""
    generator = np.random.default_rng(0)
    models = [swing_up()]
    for kind in ("implicit", "products", "monomials"):
        structure = cart_poles.structure(cart_poles.told(speed=2.0, rate=0.5, position=3.0), kind)
        shape = (len(structure.learned), structure.terms.count)
        weight = 0.1 * generator.standard_normal(shape) * structure.allowed.numpy()
        models.append(TickModel(structure, weight, 0.07, np.zeros(1), np.ones(1), substeps=3))
    return models


def slope_once(model: TickModel, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The compiled ds/dt ``[n]``, and the derivative of what is learned of it ``[L, n + m]``."""
    n = len(model.structure.source)
    room, slope = kernels()["room_for"](n, len(x) - n, model.parts), np.zeros(n)
    by = np.zeros((len(model.structure.learned), len(x)))
    kernels()["slope_jacobian"](x, model.weight, model.parts, room, slope, by)
    return slope, by


@pytest.mark.parametrize("model", _models(), ids=["true", "implicit", "products", "monomials"])
def test_a_tick_and_its_jacobian_are_those_of_torch(model: TickModel) -> None:
    x = np.random.default_rng(1).standard_normal(5)
    weight, row = torch.from_numpy(model.weight), torch.from_numpy(x)
    after, by = tick_once(model, model.weight, x[:4], x[4:])

    def moved(row: torch.Tensor) -> torch.Tensor:
        return runge_kutta(model.structure, weight, row[:4], row[4:], model.dt, model.substeps)

    np.testing.assert_allclose(after, moved(row), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(by, jacrev(moved)(row), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("model", _models(), ids=["true", "implicit", "products", "monomials"])
def test_the_derivative_is_that_of_torch(model: TickModel) -> None:
    x = np.random.default_rng(2).standard_normal(5)
    given = (model.structure, torch.from_numpy(model.weight), torch.from_numpy(x[:4]))
    action = torch.from_numpy(x[4:])
    slope, by = slope_once(model, x)
    np.testing.assert_allclose(slope, state_derivative(*given, action), rtol=1e-12, atol=1e-13)
    expected = derivative_jacobian(*given, action)[model.structure.learned]
    np.testing.assert_allclose(by, expected, rtol=1e-12, atol=1e-12)


def test_products_of_the_tree_are_the_terms() -> None:
    given = cart_poles.told()
    lift, entry = Lift.of(given), np.random.default_rng(3).standard_normal(7)
    terms = Terms.monomials(given, lift, 4)
    tree, node = product_tree(terms.factors)
    product = np.ones(len(tree))
    for p, (parent, factor) in list(enumerate(tree))[1:]:
        assert parent < p
        product[p] = product[parent] * entry[factor]
    entry[0] = 1.0
    np.testing.assert_allclose(product[node], entry[terms.factors].prod(axis=1), rtol=1e-13)
    assert len(tree) <= terms.count + 1


def test_coupled_accelerations_of_six_joints_are_solved() -> None:
    """(I - N) f = h with N that changes with the state, beyond what a cart-pole needs."""
    size = 6
    names = ("1", *(f"v{i}" for i in range(size)), "u")
    lift = Lift(np.zeros(size, bool), 1 + np.arange(size), np.ones(size), size + 1, names)
    plain = [[k] for k in range(size + 2)]
    coupled = [[1 + i] for i in range(size) for _ in range(size)]
    derivative = np.array([-1] * len(plain) + [j for _ in range(size) for j in range(size)])
    terms = Terms(np.array(plain + coupled), derivative)
    structure = Structure(lift, terms, np.arange(size), np.full(size, -1), np.zeros(size))
    generator = np.random.default_rng(4)
    weight = generator.standard_normal((size, terms.count)) * structure.allowed.numpy()
    x = generator.standard_normal(size + 1)
    slope, by = slope_once(TickModel(structure, weight, 0.1, np.zeros(1), np.ones(1)), x)

    def derivative_of(row: torch.Tensor) -> torch.Tensor:
        return state_derivative(structure, torch.from_numpy(weight), row[:size], row[size:])

    row = torch.from_numpy(x)
    np.testing.assert_allclose(slope, derivative_of(row), rtol=1e-9)
    np.testing.assert_allclose(by, jacrev(derivative_of)(row), rtol=1e-8, atol=1e-10)
