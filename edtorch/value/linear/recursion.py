r"""The same values and gradients step by step, with the population as the innermost axis.

What ``mean`` and ``moment`` say in matrix products of a library, this says in sums of products over
``[..., B]``: one learner beside the other in memory, so that a compiler makes each sum one run of
vector instructions.  Uncompiled it is slow.  The recursions go by increments, D = drift + G theta,

    s_{tau+1} = s_tau + D s_tau,          lambda_tau = q_tau + lambda_{tau+1} + D' lambda_{tau+1},
    X_{tau+1} = P_tau + P_tau D' + nu,    Lambda_tau = w_tau C + Y_tau + D' Y_tau,
    P_tau = X_tau + D X_tau,              Y_tau = Lambda_{tau+1} + Lambda_{tau+1} D,

which in float32 makes a quarter of the error that A = I + D makes.  V itself needs no sum over
time: it is quadratic in s_0, hence V = 1/2 s_0' dV/ds_0; and with covariance
V = -tr(A' Lambda_1 A X_0) - sum_tau tr(Lambda_tau nu).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from edtorch.shapes import ActionCost, Gains, Inputs, Rows, Squares, States
from edtorch.types import Belief


def _last(tensor: Tensor) -> Tensor:
    """``[B, ...] -> [..., B]``."""
    return tensor.movedim(0, -1)


def _product(a: Tensor, b: Tensor) -> Tensor:
    """Of matrices ``[i, j, B]`` and ``[j, k, B]`` (B may be 1), ``[i, k, B]``."""
    return (a.unsqueeze(2) * b.unsqueeze(0)).sum(1)


def _apply(a: Tensor, x: Tensor) -> Tensor:
    """A matrix ``[i, j, B]`` to vectors ``[j, B]``, ``[i, B]``."""
    return (a * x.unsqueeze(0)).sum(1)


def _transposed(a: Tensor, x: Tensor) -> Tensor:
    """a' x, for a ``[i, j, B]`` and x ``[i, B]``, ``[j, B]``."""
    return (a * x.unsqueeze(1)).sum(0)


def is_diagonal(cost: Tensor) -> bool:
    """Whether a cost ``[n, n]`` has nothing off its diagonal."""
    return bool((cost == torch.diag(cost.diagonal())).all())


def _cost(state_cost: Tensor, action_cost: Tensor | None, theta: Tensor) -> Tensor:
    """C = Q + theta' R theta, ``[N, N, B]`` (B = 1 without action cost)."""
    full = torch.diag(state_cost) if state_cost.ndim == 1 else state_cost
    cost = full.unsqueeze(-1)
    if action_cost is not None:
        weighed = _product(action_cost.unsqueeze(-1), theta)
        cost = cost + _product(theta.movedim(0, 1), weighed)
    return cost


def _pull(state_cost: Tensor, cost: Tensor) -> Callable[[Tensor], Tensor]:
    """s -> C s; products with the zeros of a diagonal cost are left out."""
    if state_cost.ndim == 1 and cost.shape[-1] == 1:
        return lambda s: state_cost.unsqueeze(-1) * s
    return lambda s: _apply(cost, s)


def mean_by_recursion(
    drift: Squares,
    G: Inputs,
    theta: Gains,
    start: States,
    *,
    state_cost: Tensor,
    action_cost: ActionCost | None,
    weights: Sequence[float],
) -> tuple[Rows, Gains]:
    """As ``edtorch.value.linear.mean_value_and_gradient``.

    state_cost may be the diagonal ``[n]`` of a diagonal Q, which saves products with its zeros.
    """
    D, G, theta = _last(drift), _last(G), _last(theta)
    D = D + _product(G, theta)
    cost = _cost(state_cost, action_cost, theta)
    pull = _pull(state_cost, cost)
    states = [_last(start)]
    for _ in weights:
        states.append(states[-1] + _apply(D, states[-1]))
    adjoint = (-2 * weights[-1]) * pull(states[-1])
    through = torch.zeros_like(D)
    for tau in range(len(weights), 0, -1):
        through = through + adjoint.unsqueeze(1) * states[tau - 1].unsqueeze(0)
        adjoint = adjoint + _transposed(D, adjoint)
        if tau > 1:
            adjoint = adjoint + (-2 * weights[tau - 2]) * pull(states[tau - 1])
    value = 0.5 * (adjoint * states[0]).sum(0)
    gradient = _product(G.movedim(0, 1), through)
    if action_cost is not None:
        weighed = _product(action_cost.unsqueeze(-1), theta)
        for weight, state in zip(weights, states[1:], strict=True):
            pushed = (-2 * weight) * _apply(weighed, state)
            gradient = gradient + pushed.unsqueeze(1) * state.unsqueeze(0)
    return value, gradient.movedim(-1, 0)


def moment_by_recursion(
    drift: Squares,
    G: Inputs,
    theta: Gains,
    start: Belief,
    noise: Squares,
    *,
    state_cost: Tensor,
    action_cost: ActionCost | None,
    weights: Sequence[float],
) -> tuple[Rows, Gains]:
    """As ``edtorch.value.linear.moment_value_and_gradient``; state_cost as in
    ``mean_by_recursion``."""
    D, G, theta, noise = _last(drift), _last(G), _last(theta), _last(noise)
    D = D + _product(G, theta)
    transposed = D.movedim(0, 1)
    cost = _cost(state_cost, action_cost, theta)
    mean = _last(start.mean)
    first = moment = mean.unsqueeze(1) * mean.unsqueeze(0) + _last(start.cov)
    products, weighted = [], torch.zeros_like(moment)
    for weight in weights:
        products.append(moment + _product(D, moment))
        moment = products[-1] + _product(products[-1], transposed) + noise
        if action_cost is not None:
            weighted = weighted + weight * moment
    adjoint = (weights[-1] * cost).expand(moment.shape)
    total = torch.zeros_like(moment)
    gradient = torch.zeros_like(theta)
    for tau in range(len(weights), 0, -1):
        total = total + adjoint
        gradient = gradient + _product(_product(G.movedim(0, 1), adjoint), products[tau - 1])
        right = adjoint + _product(adjoint, D)
        adjoint = right + _product(transposed, right)
        if tau > 1:
            adjoint = adjoint + weights[tau - 2] * cost
    value = -(adjoint * first + total * noise).sum((0, 1))
    gradient = -2 * gradient
    if action_cost is not None:
        weighed = _product(action_cost.unsqueeze(-1), theta)
        gradient = gradient - 2 * _product(weighed, weighted)
    return value, gradient.movedim(-1, 0)
