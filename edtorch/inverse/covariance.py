"""The value of ``edtorch.inverse.adjoint`` with the covariance in it, to first order (eq. 2).

    Sigma' = nu + J Sigma J',   V = -sum_tau w_tau (|q_tau - g|^2 + tr Sigma_tau,qq)

With x = (s, bent h), h = D s + ..., and L = (L_s, L_b) acting on s and on what is bent,

    J = L_s + L_b diag(slope) D,

which is known for all steps once the mean has been unrolled.  Two more chains of small products
remain, Sigma forward and P = dV/dSigma backward, P_tau = -w_tau E + J' P_tau+1 J; and with
R = L_b' (2 P_tau+1 J Sigma), V depends on a slope by the row of R times that of D, and on D itself
by diag(slope) R.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from edtorch.inverse.adjoint import Adjoint, Loop, Walk, back, distance, of_learner, walk


def jacobians(loop: Loop, walked: Walk) -> Tensor:
    """J of each step, ``[T, B M, S, S]``."""
    size = loop.step.shape[-2]
    steps, learners, starts, _ = walked.slope.shape
    scaled = loop.step[:, None, :, size:] * of_learner(walked.slope).unsqueeze(-2)
    bent = (scaled.flatten(1, 2) @ walked.bending).unflatten(1, (steps, starts, size))
    J = bent + loop.step[:, None, None, :, :size]
    return J.movedim(0, 1).reshape(steps, learners * starts, size, size)


def adjoint_with_covariance(
    loop: Loop,
    state: Tensor,
    goal: Tensor,
    weights: Sequence[float],
    noise: Tensor,
    start: Tensor,
) -> Adjoint:
    """As ``adjoint``; noise nu ``[B, S, S]``, of one step; start: Sigma of tau = 0, ``[S, S]``."""
    walked = walk(loop, state, len(weights))
    value, pulls = distance(walked, goal, weights)
    steps, learners, starts, size = pulls.shape
    n, m, bends = goal.shape[-1], loop.gains.shape[-2], walked.slope.shape[-1]

    # Forward: Sigma, and J Sigma of each step, which the way back asks for again.
    rows = learners * starts
    J = jacobians(loop, walked)
    added = noise.unsqueeze(1).expand(-1, starts, -1, -1).reshape(rows, size, size)
    cov = start.expand(rows, size, size)
    moved = torch.empty_like(J)
    for step, half, w in zip(J.unbind(0), moved.unbind(0), weights, strict=True):
        torch.bmm(step, cov, out=half)
        cov = torch.baddbmm(added, half, step.mT)
        variance = cov.diagonal(dim1=-2, dim2=-1)[:, :n].sum(-1)
        value = value - w * variance.view(learners, starts)

    # Backward: P of tau = T..1.
    by_cov = torch.empty_like(J)
    spread = state.new_zeros(size, size)
    spread.diagonal()[:n] = 1
    costs = [-w * spread for w in weights]
    P = costs[-1].expand(rows, size, size)
    by_cov[-1] = P
    for tau in range(steps - 1, 0, -1):
        P = torch.baddbmm(costs[tau - 1], J[tau].mT, P @ J[tau])
        by_cov[tau - 1] = P

    # R' of each step [B, T, M, S, 2 A + m]: V = ... through the slopes, and through K in D.
    by_J = torch.bmm((2 * moved).flatten(0, 1).mT, by_cov.flatten(0, 1))
    by_J = by_J.view(steps, learners, starts * size, size).movedim(0, 1).flatten(1, 2)
    R = (by_J @ loop.step[..., size:]).view(learners, steps, starts, size, bends)
    slopes = (R * walked.bending.mT[:, None, None]).sum(-2).movedim(0, 1)
    straight = walked.slope.movedim(0, 1)[..., None, -m:]
    by_direction = (R[..., -m:] * straight).sum((1, 2)).mT

    drives = back(loop, walked, pulls, slopes * _curvature(loop, walked))[..., -m:]
    by_gains = of_learner(drives).mT @ of_learner(walked.state[:-1])
    return Adjoint(value, by_gains + by_direction, drives.sum(0))


def _curvature(loop: Loop, walked: Walk) -> Tensor:
    """d slope / dh, ``[T, B, M, 2 A + m]``: -sin, and that of tanh, -2 t (1 - t^2)."""
    m = loop.gains.shape[-2]
    bent = walked.x[..., -walked.slope.shape[-1] :]
    t = bent[..., -m:]
    of_tanh = -2 * t * walked.slope[..., -m:] if loop.bounded else torch.zeros_like(t)
    return torch.cat((-bent[..., :-m], of_tanh), -1)
