"""Curvatures and Jacobians against torch's own and against closed forms."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.derivatives import (
    curvature,
    curvature_products,
    directional,
    loop_jacobian,
    rowwise_jacobian,
    scalar_curvature,
)
from edtorch.model.features import FeatureMap, Identity, Pairwise
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.policy.policies import LinearPolicy, SquashedPolicy
from edtorch.value.closed_loop import ClosedLoop
from tests.systems import normal, random_cost


def function(s: Tensor) -> Tensor:
    """Two components of three variables."""
    return torch.stack([s.prod(-1), s[..., 0].sin() * s[..., 1].exp()], dim=-1)


def test_directional_is_the_jacobian_times_the_direction() -> None:
    g = torch.Generator().manual_seed(0)
    x, u = normal(g, 4, 3), normal(g, 4, 3)
    wanted = (rowwise_jacobian(function, x) @ u.unsqueeze(-1)).squeeze(-1)
    assert torch.allclose(directional(function, u)(x), wanted, rtol=1e-13)


def test_curvature_is_the_hessian_against_the_covariance() -> None:
    g = torch.Generator().manual_seed(1)
    x, C = normal(g, 2, 4, 3), normal(g, 2, 4, 3, 3)
    C = C @ C.mT
    hessian = torch.func.vmap(torch.func.vmap(torch.func.jacrev(torch.func.jacrev(function))))(x)
    wanted = (hessian * C.unsqueeze(-3)).sum((-1, -2))
    assert torch.allclose(curvature(function, x, C), wanted, rtol=1e-12)
    first = scalar_curvature(lambda s: function(s)[..., 1], x, C)
    assert torch.allclose(first, wanted[..., 1], rtol=1e-12)
    products = torch.movedim(hessian @ C.unsqueeze(-3), -1, 0)
    assert torch.allclose(curvature_products(function, x, C), products, rtol=1e-12)


@pytest.mark.parametrize("shape", [(), (2,), (2, 2)])
def test_curvature_of_constants_and_of_any_shape(shape: tuple[int, ...]) -> None:
    x, C = torch.ones(5, 2).double(), torch.eye(2).double()
    constant = curvature(lambda s: torch.ones(*s.shape[:-1], *shape).to(s), x, C)
    assert constant.shape == (5, *shape) and not bool(constant.any())


@pytest.mark.parametrize("kind", [DerivativeModel, NextStateModel])
def test_a_linear_loop_offers_its_jacobian(kind: type) -> None:
    g = torch.Generator().manual_seed(2)
    model = kind(3, 2, Identity(5), torch.zeros(3).double())
    weights = {"weight": normal(g, 4, 3, 5)}, {"weight": normal(g, 4, 2, 3)}
    loop = ClosedLoop(model, LinearPolicy(3, 2, Identity(3)), *weights, 0.05)
    state = normal(g, 4, 3)
    offered = loop.jacobian(state)
    assert offered is not None and torch.equal(loop_jacobian(loop, state), offered)
    assert torch.allclose(offered, rowwise_jacobian(loop, state), rtol=1e-13)
    more = normal(g, 6, 4, 3)
    assert torch.allclose(loop_jacobian(loop, more), rowwise_jacobian(loop, more), rtol=1e-13)


@pytest.mark.parametrize(
    ("features", "kind"), [(Pairwise(5), LinearPolicy), (Identity(5), SquashedPolicy)]
)
def test_other_loops_are_differentiated(features: FeatureMap, kind: type) -> None:
    g = torch.Generator().manual_seed(3)
    model = DerivativeModel(3, 2, features, torch.zeros(3).double())
    weights = {"weight": normal(g, 4, 3, features.outputs)}, {"weight": normal(g, 4, 2, 3)}
    loop = ClosedLoop(model, kind(3, 2, Identity(3)), *weights, 0.05)
    state = normal(g, 4, 3)
    assert loop.jacobian(state) is None
    assert torch.equal(loop_jacobian(loop, state), rowwise_jacobian(loop, state))


def test_any_object_may_offer_its_jacobian() -> None:
    class Doubling:
        def __call__(self, state: Tensor) -> Tensor:
            return 2 * state

        def jacobian(self, state: Tensor) -> Tensor:
            return (2 * torch.eye(3).double()).expand(*state.shape, 3)

    x = random_cost(torch.Generator().manual_seed(4), 3)
    assert torch.equal(loop_jacobian(Doubling(), x)[0], 2 * torch.eye(3).double())
    assert torch.allclose(loop_jacobian(Doubling(), x), rowwise_jacobian(Doubling(), x))
