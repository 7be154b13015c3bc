r"""Derivatives of functions that work row by row: slopes, and curvatures against a covariance.

A covariance enters every second-order formula of the method as the contraction

    (H : \Sigma)^i = \sum_{jk} \Sigma^{jk} \partial^2 f^i / \partial s^j \partial s^k
                   = \sum_k D^2 f(s)[\Sigma e_k, e_k],

n nested Jacobian-vector products.  Written so, it needs no square root of Sigma, and it is safe
and differentiable at Sigma = 0, where every online rollout starts.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacrev, vjp

from edtorch.shapes import Rows, Squares, States

StateFunction = Callable[[Tensor], Tensor]
"""A function of states that works row by row: ``[*batch, n] -> [*batch, ...]``.

It takes further leading dimensions, ``[k, *batch, n] -> [k, *batch, ...]``: whatever it closes over
broadcasts from the right, as torch's operations do.
"""


def rowwise_jacobian(function: StateFunction, state: States) -> Float[Tensor, "*batch p n"]:
    """Jacobian of a row-by-row ``function`` at each row of ``state`` by ``torch.func.jacrev``.

    state ``[*batch, n]``, function ``[*batch, n] -> [*batch, p]``; returns ``[*batch, p, n]``.
    Rows do not mix, so the Jacobian of the sum over rows holds every row's own Jacobian.
    """

    def summed(x: Tensor) -> Tensor:
        out = function(x)
        return out.reshape(-1, out.shape[-1]).sum(0)

    jacobian = jacrev(summed)(state)
    return torch.movedim(jacobian, 0, -2)


def loop_jacobian(closed_loop: StateFunction, state: States) -> Squares:
    """J = d mu_pi / ds ``[*batch, n, n]`` at ``state`` ``[*batch, n]``, through model and policy.

    A closed loop that is an object with a method ``jacobian(state)`` is asked first; where it has
    none, or answers None, J comes from ``rowwise_jacobian``, the reference.
    """
    offered = getattr(closed_loop, "jacobian", None)
    found = offered(state) if offered is not None else None
    return rowwise_jacobian(closed_loop, state) if found is None else found


def directional(function: StateFunction, direction: Tensor) -> StateFunction:
    """The function x -> D f(x)[u], ``[*batch, n] -> [*batch, *shape]``; u ``[*batch, n]``.

    By two reverse passes (the pullback w -> w' D f is linear, so its own pullback of u is D f u),
    which torch runs faster at these sizes than its forward mode, and differentiates as well.
    """

    def along(x: Tensor) -> Tensor:
        pulled = vjp(function, x)
        out, pull = pulled[0], pulled[1]
        return vjp(lambda w: pull(w)[0], torch.zeros_like(out))[1](direction)[0]

    return along


def _rows(state: Tensor, cov: Tensor) -> tuple[Tensor, Tensor]:
    """The state n times and the columns Sigma e_k beside it: both ``[n, *batch, n]``."""
    n = state.shape[-1]
    columns = cov.expand(*state.shape, n).movedim(-1, 0)
    return state.expand(n, *state.shape), columns


def curvature(function: StateFunction, state: States, cov: Float[Tensor, "*#batch n n"]) -> Tensor:
    """H : Sigma of each component of ``function`` at each row of ``state``.

    state ``[*batch, n]``, cov ``[*batch, n, n]``, function ``[*batch, n] -> [*batch, *shape]``;
    returns ``[*batch, *shape]``.  Half of it is what a random state with this covariance adds to
    the mean of f, exactly if f is quadratic.
    """
    states, columns = _rows(state, cov)
    n = state.shape[-1]
    eye = torch.eye(n, dtype=state.dtype, device=state.device)
    units = eye.view(n, *[1] * (state.ndim - 1), n).expand(states.shape)
    return directional(directional(function, columns), units)(states).sum(0)


def scalar_curvature(function: StateFunction, state: States, cov: Squares) -> Rows:
    """``curvature`` of a function of one value a row, ``[*batch, n] -> [*batch]``, for half of it.

    tr(H Sigma) from the n Hessian-vector products H Sigma e_k: H is symmetric here, so one reverse
    pass through the gradient gives each.
    """

    def gradient(x: Tensor) -> Tensor:
        pulled = vjp(function, x)
        return pulled[1](torch.ones_like(pulled[0]))[0]

    states, columns = _rows(state, cov)
    products = vjp(gradient, states)[1](columns)[0]
    return torch.diagonal(products, dim1=0, dim2=-1).sum(-1)


def curvature_products(
    function: StateFunction, state: States, cov: Squares
) -> Float[Tensor, "n *batch p n"]:
    """(H_i Sigma)_ab = D^2 f_i(s)[e_a, Sigma e_b] as ``[b, *batch, i, a]``.

    state ``[*batch, n]``, cov ``[*batch, n, n]``, function ``[*batch, n] -> [*batch, p]``.  Their
    trace over a = b is ``curvature``.
    """
    states, columns = _rows(state, cov)
    return rowwise_jacobian(directional(function, columns), states)
