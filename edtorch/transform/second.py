r"""Mean and covariance to second order, exact for quadratic closed loops and Gaussian states."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from edtorch.derivatives import StateFunction, curvature, curvature_products, loop_jacobian
from edtorch.rewards import Reward, expected_reward
from edtorch.shapes import Rows
from edtorch.transform.noise import is_constant
from edtorch.transform.positive import symmetric
from edtorch.types import Belief


@dataclass(frozen=True)
class SecondOrder:
    r"""Mean and covariance with the curvature of mu_pi and nu_pi.

        mean' = mu + 1/2 H:Sigma,
        cov' = nu + 1/2 D^2 nu:Sigma + J Sigma J' + 1/2 [tr(H_i Sigma H_j Sigma)]_ij,

    all at the mean, H_i = D^2 mu_pi^i.  For mu_pi quadratic the mean is exact under any
    distribution and the covariance under a Gaussian one (the moments of quadratic forms; Isserlis).
    No square root of Sigma is taken, so it is safe at Sigma = 0.

    Both terms in mu are positive semidefinite by construction (the second is the Gram matrix of
    the Sigma^1/2 H_i Sigma^1/2).  The correction of a state-dependent nu is not: nu + 1/2 D^2
    nu:Sigma is the mean of nu's parabola, which may dip below zero where nu does not.  It is kept,
    because leaving it out costs the covariance its second order, and the unroll floors what becomes
    negative and says so; a ``ConstantNoise`` has no such term and needs no floor.

    Costs n^2 nested Jacobian-vector products a step; meant first of all for the error estimate of
    ``edtorch.value.error_estimate``.
    """

    propagates_covariance = True
    differentiates_reward = True
    exact_for_linear = True

    def keeps_positive(self, noise: StateFunction) -> bool:
        """Only without the noise's curvature."""
        return is_constant(noise)

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """One step; see the class."""
        mean, cov = belief.mean, belief.cov
        jacobian = loop_jacobian(closed_loop, mean)
        products = curvature_products(closed_loop, mean, cov)
        bend = torch.einsum("a...ia->...i", products)
        spread = torch.einsum("b...ia,a...jb->...ij", products, products)
        added = noise(mean)
        if not is_constant(noise):
            added = added + 0.5 * curvature(noise, mean, cov)
        moved = added + jacobian @ cov @ jacobian.mT + 0.5 * spread
        return Belief(closed_loop(mean) + 0.5 * bend, symmetric(moved))

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """Eq. 1, with the curvature of the policy in it."""
        return expected_reward(reward, belief, policy)
