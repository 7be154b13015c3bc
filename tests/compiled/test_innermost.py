"""The rewriting of operations for a batch that is innermost says the same as the operations."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from edtorch.compiled.innermost import RULES, Turned, first, last
from tests.systems import normal

aten = torch.ops.aten
G = torch.Generator().manual_seed(0)
A, B, C = normal(G, 6, 3, 4), normal(G, 6, 4, 2), normal(G, 6, 3, 2)

CASES = [
    (aten.bmm.default, (A, B), {}),
    (aten.matmul.default, (A, B), {}),
    (aten.matmul.default, (normal(G, 5, 3), A), {}),
    (aten.matmul.default, (A, normal(G, 4, 2)), {}),
    (aten.matmul.default, (A, normal(G, 4)), {}),
    (aten.baddbmm.default, (C, A, B), {"beta": 0.5, "alpha": 2.0}),
    (aten.sum.dim_IntList, (A, [-1]), {}),
    (aten.sum.dim_IntList, (A, [1, 2]), {"keepdim": True}),
    (aten.sum.dim_IntList, (A, [0, 1]), {}),
    (aten.mean.dim, (A, [-1]), {}),
    (aten.cat.default, ([A, C], -1), {}),
    (aten.cat.default, ([A[:, :, 0], C[:, :, 1]], 1), {}),
    (aten.cat.default, ([A, A], 0), {}),
    (aten.stack.default, ([A[:, 0], A[:, 1]], -1), {}),
    (aten.stack.default, ([A[:, 0, 0], A[:, 1, 1]], 1), {}),
    (aten.stack.default, ([A, A], 0), {}),
    (aten.view.default, (A, [6, 12]), {}),
]


@pytest.mark.parametrize(("operation", "arguments", "more"), CASES)
def test_rules_say_the_same_as_the_operations(
    operation: Any, arguments: Any, more: dict[str, Any]
) -> None:
    wanted = operation(*arguments, **more)
    found = RULES[operation](*arguments, **more)
    assert found.shape == wanted.shape
    assert torch.allclose(found, wanted, rtol=1e-13, atol=1e-13)


def test_storage_and_shape() -> None:
    stored = last(A)
    assert stored.shape == (3, 4, 6) and stored.is_contiguous()
    assert torch.equal(first(stored), A)


def test_a_turned_graph_says_the_same_and_lays_out_otherwise() -> None:
    class Function(nn.Module):
        def forward(self, a: Tensor, b: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
            product = a @ b
            joined = torch.cat(
                [product, torch.stack([mask * 1.0, mask * 2.0, mask * 3.0], -1)[..., None]], -1
            )
            picked = torch.where(mask.view(-1, 1, 1) > 0, joined, 0.5 * joined.abs().sqrt())
            return picked, picked.sum((1, 2)), picked.float()

    mask = normal(G, 6)
    function, arguments = Function(), (A, B, mask)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exported = torch.export.export(function, arguments, strict=False).run_decompositions({})
    found = Turned(exported.module(), 6)(*arguments)
    for one, other in zip(found, function(*arguments), strict=True):
        assert one.dtype == other.dtype and torch.allclose(one, other, rtol=1e-12)
    # The batch has the stride 1.
    assert found[0].stride(0) == 1 and found[2].stride(0) == 1
