r"""Shared by the point transforms: propagate weighted points through the closed loop, take moments.

Nodes z_k with weights w_k > 0, sum w = 1, sum w z = 0, sum w z z' = I, stand for a standardised
state; the points are x_k = s~ + L z_k with L L' = Sigma.  With y_k = mu_pi(x_k), y = sum w_k y_k,

    sum_k w_k (y_k - y)(y_k - y)' = A Sigma A' + sum_k w_k e_k e_k',
    A L = sum_k w_k (y_k - y) z_k',      e_k = y_k - y - A L z_k,

A being the slope of the regression of y on x and e_k its residuals.  Both terms are positive
semidefinite for any y, so the covariance is so by construction.

The square root.  Cholesky's factor does not exist at Sigma = 0, where every online rollout starts,
and the derivative of any factor is infinite where Sigma is singular.  L is therefore Cholesky's
factor of Sigma + jitter, with a diagonal jitter of eps^(2/3) of each variance (or of 1, the unit of
a scaled state, where a variance is below eps^(2/3)): truncation, of the order of the jitter, and
rounding, eps / sqrt(jitter), balance there for the derivatives with respect to Sigma.  The points
are slightly too far apart, but the covariance is A Sigma A' with Sigma itself, so the jitter does
not accumulate; a linear closed loop has rounding errors only.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.rewards.base import Reward, exact_expectation
from edtorch.shapes import Rows, Squares
from edtorch.transform.positive import symmetric
from edtorch.types import Belief


class Nodes(NamedTuple):
    """z ``[k, n]`` and weight w ``[k]``, as in the module's description."""

    z: Tensor
    weight: Tensor


def factor(cov: Squares) -> Squares:
    """Lower triangular L ``[*batch, n, n]`` with L L' = cov + jitter; see the module.

    Differentiable at every positive semidefinite ``cov``, 0 included.  Rows that are not positive
    semidefinite, or not finite, become NaN: the caller's checks then find them.
    """
    small = torch.finfo(cov.dtype).eps ** (2 / 3)
    variance = torch.diagonal(cov, dim1=-2, dim2=-1).detach()
    jitter = small * torch.where(variance > small, variance, 1.0)
    lower, failed = torch.linalg.cholesky_ex(cov + torch.diag_embed(jitter))
    return torch.where((failed == 0)[..., None, None], lower, torch.nan)


def _points(belief: Belief, lower: Tensor, nodes: Nodes) -> Tensor:
    """x_k ``[k, *batch, n]``."""
    return belief.mean + (lower @ nodes.z.mT).movedim(-1, 0)


def _average(weight: Tensor, values: Tensor) -> Tensor:
    """Sum over the leading dimension of ``values`` ``[k, ...]``."""
    return torch.tensordot(weight, values, dims=1)


def move(belief: Belief, closed_loop: StateFunction, noise: StateFunction, nodes: Nodes) -> Belief:
    """The moments of the closed loop over the points, plus nu averaged over them."""
    lower = factor(belief.cov)
    points = _points(belief, lower, nodes)
    moved = closed_loop(points)
    mean = _average(nodes.weight, moved)
    deviation = (moved - mean).movedim(0, -1)
    slope_times_lower = deviation @ (nodes.weight.unsqueeze(-1) * nodes.z)
    residual = deviation - slope_times_lower @ nodes.z.mT
    slope = torch.linalg.solve_triangular(lower, slope_times_lower, upper=False, left=False)
    cov = slope @ belief.cov @ slope.mT + (residual * nodes.weight) @ residual.mT
    return Belief(mean, symmetric(cov + _average(nodes.weight, noise(points))))


def reward(reward: Reward, belief: Belief, policy: StateFunction, nodes: Nodes) -> Rows:
    """r_pi averaged over the points, ``[*batch]``, unless the reward knows its expectation."""
    exact = exact_expectation(reward, belief)
    if exact is not None:
        return exact
    points = _points(belief, factor(belief.cov), nodes)
    return _average(nodes.weight, reward(points, policy(points)))
