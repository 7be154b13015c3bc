r"""The linear-quadratic regulator: what the best linear policy would be, and what it would earn.

For s' = F s + G a + noise(nu), r = -(s'Q s + a'R a), discounted by gamma per step.  A discount is
no more than a scaling: sqrt(gamma) F and sqrt(gamma) G without one.  After Anderson & Moore,
"Optimal Control: Linear Quadratic Methods", chapters 2-3; the doubling of the Riccati equation
after Anderson, "Second-order convergent algorithms for the steady-state Riccati equation", 1978.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edtorch.shapes import ActionCost, Gains, Inputs, Rows, Squares, StateCost
from edtorch.types import Belief


class NotConverged(ValueError):
    """A stationary solution does not exist, or is not reached in float64."""


@dataclass(frozen=True)
class LqrSolution:
    """gains theta of a = theta s, ``[T, *batch, m, n]``, first step first; cost ``[*batch, n, n]``,
    the P_0 of V = -(mean'P_0 mean + tr(P_0 cov) + noise); costs ``[T + 1, *batch, n, n]``,
    P_0..P_T.
    """

    gains: Tensor
    cost: Tensor
    costs: Tensor


def _gain(F: Tensor, G: Tensor, R: Tensor, P: Tensor, discount: float) -> Tensor:
    pull = discount * G.mT @ P
    return -torch.linalg.solve(R + pull @ G, pull @ F)


def finite_horizon_lqr(
    F: Squares, G: Inputs, Q: StateCost, R: ActionCost, *, steps: int, discount: float = 1.0
) -> LqrSolution:
    """Riccati's recursion backwards: the gains that maximise the sum of ``steps`` + 1 rewards.

    The sum is that of section 3's definition, gamma^k r(s_k, a_k) for k = 0..steps, where the last
    action costs and moves nothing that counts: it is zero.  F ``[*batch, n, n]``, G ``[*batch, n,
    m]``, Q ``[n, n]`` positive semidefinite, R ``[m, m]`` positive definite.
    """
    P = Q.expand(F.shape)
    gains, costs = [], [P]
    for _ in range(steps):
        theta = _gain(F, G, R, P, discount)
        A = F + G @ theta
        P = Q + theta.mT @ R @ theta + discount * A.mT @ P @ A
        P = 0.5 * (P + P.mT)
        gains.insert(0, theta)
        costs.insert(0, P)
    return LqrSolution(torch.stack(gains), P, torch.stack(costs))


def _doubled(A: Tensor, W: Tensor, H: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(A, W, H) of twice the horizon, and what H has grown by; see ``stationary_lqr``.

    Never raises: what cannot be inverted comes back as numbers that are not finite.
    """
    eye = torch.eye(H.shape[-1], dtype=H.dtype, device=H.device)
    inverse = torch.linalg.inv_ex(eye + W @ H).inverse
    growth = A.mT @ H @ inverse @ A
    W = W + A @ inverse @ W @ A.mT
    return A @ inverse @ A, W, 0.5 * (growth + growth.mT)


def stationary_lqr(
    F: Squares,
    G: Inputs,
    Q: StateCost,
    R: ActionCost,
    *,
    discount: float = 1.0,
    tolerance: float = 1e-13,
) -> tuple[Gains, Squares]:
    """Gain theta ``[*batch, m, n]`` and cost P ``[*batch, n, n]`` of the infinite horizon.

    Solves P = Q + F'P F - F'P G (R + G'P G)^-1 G'P F (discounted) by doubling the horizon at each
    step.  Raises NotConverged if (F, G) cannot be stabilised.
    """
    scale = discount**0.5
    A, H = scale * F, Q.expand(F.shape)
    B = scale * G
    W = B @ torch.linalg.solve(R, B.mT)
    for _ in range(60):
        A, W, growth = _doubled(A, W, H)
        H = H + growth
        if not bool(H.isfinite().all()):
            break
        if bool((growth.abs().amax((-1, -2)) <= tolerance * H.abs().amax((-1, -2))).all()):
            return _gain(F, G, R, H, discount), H
    raise NotConverged("no stationary regulator: the system cannot be stabilised by its actions")


def doubled_lqr(
    F: Squares,
    G: Inputs,
    Q: Float[Tensor, "*#batch n n"],
    R: Float[Tensor, "*#batch m m"],
    *,
    doublings: int,
) -> Gains:
    """Gain theta ``[*batch, m, n]`` of the first of 2^doublings steps.

    As ``stationary_lqr``, without a look at any number on the way: systems that cannot be
    stabilised have such a gain as well, and where it is beyond float64 it comes back not finite.
    """
    A, H = F, Q.expand(F.shape)
    W = G @ torch.linalg.solve(R, G.mT)
    for _ in range(doublings):
        A, W, growth = _doubled(A, W, H)
        H = H + growth
    pull = G.mT @ H
    return -torch.linalg.solve_ex(R + pull @ G, pull @ F).result


def stationary_covariance(A: Squares, noise: Squares, *, tolerance: float = 1e-14) -> Squares:
    """Sigma = A Sigma A' + nu, ``[*batch, n, n]``, by doubling (Smith, 1968).

    Raises NotConverged unless every eigenvalue of A is inside the unit circle.
    """
    power, total = A, noise
    for _ in range(60):
        more = power @ total @ power.mT
        total = total + more
        power = power @ power
        if not bool(total.isfinite().all()):
            break
        if bool((more.abs().amax((-1, -2)) <= tolerance * total.abs().amax((-1, -2))).all()):
            return total
    raise NotConverged("no stationary covariance: the closed loop is not stable")


def regulated_value(solution: LqrSolution, start: Belief, noise: Squares, discount: float) -> Rows:
    """V ``[*batch]`` of a regulator from ``start`` under noise nu ``[*batch, n, n]``.

    -(mean'P_0 mean + tr(P_0 cov) + sum_{k=1..T} gamma^k tr(P_k nu)): exact for any distribution of
    the noise.
    """
    first = start.mean.unsqueeze(-1) * start.mean.unsqueeze(-2) + start.cov
    total = (solution.cost * first).sum((-1, -2))
    for k, P in enumerate(solution.costs[1:], start=1):
        total = total + discount**k * (P * noise).sum((-1, -2))
    return -total
