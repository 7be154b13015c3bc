"""A learned model over a tick as a function of tensors, compiled, which torch differentiates.

Eager operations on the few numbers of a state take a hundred times as long as the numbers do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.search.program import kernels
from edtorch.search.tick_model import TickModel, real

_STEP = 1e-5
"""Of central differences of Jacobians, in scaled units: their error is of the order of its
square."""


@dataclass(frozen=True, eq=False)
class CompiledTicks:
    """s' of s ``[*batch, n]`` and u ``[*batch, m]``, and its Jacobian.

    Both have derivatives of first order: that of s' is its Jacobian, exact; that of the Jacobian is
    by central differences.
    """

    model: TickModel

    def __call__(self, state: Tensor, action: Tensor) -> Tensor:
        """``[*batch, n]``."""
        return _next(torch.cat([state, action], dim=-1), self.model)

    def jacobian(self, state: Tensor, action: Tensor) -> Tensor:
        """d s' / d (s, u), ``[*batch, n, n + m]``."""
        return _jacobian(torch.cat([state, action], dim=-1), self.model)


def drawn_ticks(model: TickModel, weight: np.ndarray, state: Tensor, action: Tensor) -> Tensor:
    """s' ``[P, R, n]`` of s ``[P, R, n]`` and u ``[P, R, m]`` with the weights ``[P, L, K]`` of
    each P, without derivatives."""
    x = real(torch.cat([state, action], dim=-1).numpy())
    after = np.zeros(state.shape)
    kernels()["ticks"](x, real(weight), model.parts, after)
    return torch.from_numpy(after)


def _tick(x: Tensor, model: TickModel) -> tuple[Tensor, Tensor]:
    """s' and its Jacobian of rows x = (s, u) ``[*batch, n + m]``."""
    n, width = len(model.structure.source), x.shape[-1]
    rows = real(x.detach().reshape(-1, width).numpy())
    after, by = np.zeros((len(rows), n)), np.zeros((len(rows), n, width))
    kernels()["tick_jacobians"](rows, real(model.weight), model.parts, after, by)
    batch = x.shape[:-1]
    return torch.from_numpy(after).view(*batch, n), torch.from_numpy(by).view(*batch, n, width)


class _Next(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, model: TickModel) -> Tensor:
        after, by = _tick(x, model)
        ctx.save_for_backward(by)
        return after

    @staticmethod
    def backward(ctx: Any, *upon: Tensor) -> tuple[Tensor, None]:
        (by,) = ctx.saved_tensors
        return (upon[0].unsqueeze(-2) @ by).squeeze(-2), None


class _Jacobian(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, model: TickModel) -> Tensor:
        ctx.save_for_backward(x)
        ctx.model = model
        return _tick(x, model)[1]

    @staticmethod
    def backward(ctx: Any, *upon: Tensor) -> tuple[Tensor, None]:
        (x,) = ctx.saved_tensors
        step = _STEP * torch.eye(x.shape[-1], dtype=x.dtype)
        ahead = _tick(x.unsqueeze(-2) + step, ctx.model)[1]
        behind = _tick(x.unsqueeze(-2) - step, ctx.model)[1]
        change = (ahead - behind) / (2 * _STEP)
        return (upon[0].unsqueeze(-3) * change).sum((-2, -1)), None


def _next(x: Tensor, model: TickModel) -> Tensor:
    found = _Next.apply(x, model)
    assert isinstance(found, Tensor)
    return found


def _jacobian(x: Tensor, model: TickModel) -> Tensor:
    found = _Jacobian.apply(x, model)
    assert isinstance(found, Tensor)
    return found
