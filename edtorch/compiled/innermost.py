"""Graphs of ``[B, ...]`` rewritten so that the batch is the innermost axis of all that is stored.

Shapes are what they are everywhere; only the storage is turned about, so that the elements of a
batch lie side by side and every operation is a run of vector instructions over them.  What a
library would do with matrices (``bmm``, ``cat`` along rows) is written out for that (``RULES``);
nothing else differs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

aten = torch.ops.aten


def last(tensor: Tensor) -> Tensor:
    """``[B, ...]`` stored with the batch innermost: contiguous ``[..., B]``."""
    return tensor.movedim(0, -1).contiguous()


def first(tensor: Tensor) -> Tensor:
    """``[..., B]`` seen as ``[B, ...]``."""
    return tensor.movedim(-1, 0)


def stored(tensor: Tensor) -> Tensor:
    """``last``, as a tensor of its own in any case."""
    return tensor.movedim(0, -1).clone(memory_format=torch.contiguous_format)


def _sum_of_products(a: Tensor, b: Tensor) -> Tensor:
    """``bmm`` of matrices too small for a library."""
    a, b = a.movedim(0, -1), b.movedim(0, -1)
    return first((a.unsqueeze(2) * b.unsqueeze(0)).sum(1))


def _matmul(a: Tensor, b: Tensor) -> Tensor:
    """``matmul`` of matrices of the batch, or of one matrix and those of the batch."""
    if not (2 <= a.ndim <= 3 and 2 <= b.ndim <= 3):
        return torch.matmul(a, b)
    return _sum_of_products(*(x.unsqueeze(0) if x.ndim == 2 else x for x in (a, b)))


def _sum_of_products_and(
    c: Tensor, a: Tensor, b: Tensor, *, beta: float = 1, alpha: float = 1
) -> Tensor:
    return beta * c + alpha * _sum_of_products(a, b)


def _reduced(reduce: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """A reduction over other axes than the batch."""

    def over(tensor: Tensor, dim: list[int], keepdim: bool = False, **more: Any) -> Tensor:
        axes = [d % tensor.ndim - 1 for d in dim]
        if min(axes) < 0:
            return reduce(tensor, dim, keepdim, **more)
        return first(reduce(tensor.movedim(0, -1), axes, keepdim, **more))

    return over


def _joined(tensors: list[Tensor], dim: int = 0) -> Tensor:
    """``cat`` along another axis than the batch."""
    axis = dim % tensors[0].ndim - 1
    if axis < 0:
        return torch.cat(tensors)
    rows = torch.cat([t.movedim(0, -1).movedim(axis, 0) for t in tensors])
    return first(rows.movedim(0, axis))


def _stacked(tensors: list[Tensor], dim: int = 0) -> Tensor:
    """``stack`` along another axis than the batch."""
    if dim % (tensors[0].ndim + 1) == 0:
        return torch.stack(tensors)
    return _joined([t.unsqueeze(dim) for t in tensors], dim)


RULES: dict[Any, Callable[..., Tensor]] = {
    aten.matmul.default: _matmul,
    aten.bmm.default: _sum_of_products,
    aten.baddbmm.default: _sum_of_products_and,
    aten.sum.dim_IntList: _reduced(torch.sum),
    aten.mean.dim: _reduced(torch.mean),
    aten.cat.default: _joined,
    aten.stack.default: _stacked,
    aten.view.default: torch.reshape,
}
"""Operations that are done otherwise when the batch is the innermost axis."""

CONVERSIONS = {aten._to_copy.default, aten.to.dtype}
"""Elementwise operations that torch does not tag as such."""


class Innermost(torch.fx.Interpreter):
    """Runs a graph of ``[B, ...]`` so that whatever it stores has the batch innermost.

    The compiler lays a result out as its logical shape says: operations on ``[B, ...]`` are done on
    ``[..., B]``, and looked at the other way round afterwards, which costs nothing.
    """

    def __init__(self, module: torch.fx.GraphModule, size: int) -> None:
        super().__init__(module)
        self._size = size

    def call_function(self, target: Any, args: Any, kwargs: Any) -> Any:
        """One operation."""
        tensors = [x for x in pytree.tree_leaves(args) if isinstance(x, Tensor)]
        rank = max((x.ndim for x in tensors), default=0)
        is_batched = any(x.ndim == rank and x.shape[0] == self._size for x in tensors if x.ndim)
        if not is_batched:
            return super().call_function(target, args, kwargs)
        if target in RULES:
            return RULES[target](*args, **kwargs)
        if rank > 1 and (torch.Tag.pointwise in target.tags or target in CONVERSIONS):

            def turned(x: Any) -> Any:
                if not isinstance(x, Tensor) or x.ndim == 0:
                    return x
                return x[(None,) * (rank - x.ndim)].movedim(0, -1)

            return first(target(*pytree.tree_map(turned, args), **kwargs))
        return super().call_function(target, args, kwargs)


class Turned(torch.nn.Module):
    """An exported graph of a batch of ``size``, as a module that runs it by ``Innermost``."""

    def __init__(self, module: torch.fx.GraphModule, size: int) -> None:
        super().__init__()
        self.module, self.size = module, size

    def forward(self, *arguments: Any) -> Any:
        """The graph's outputs; arguments: its inputs, or lists of them."""
        flat = pytree.tree_leaves(arguments)
        return Innermost(self.module, self.size).run(*flat)
