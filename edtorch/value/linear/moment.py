r"""Value and gradient with covariance: the finite-horizon Lyapunov recursion and its adjoint.

For a linear closed loop s' = A s + noise, A = F + G theta, mean and covariance need no recursions
of their own: with the second moment X = mean mean' + cov (section 3, f'; exact here),

    X_0 = s s' + Sigma_0,  X_{tau+1} = A X_tau A' + nu,  V = -sum_tau w_tau tr(C X_tau),
    C = Q + theta' R theta,

    Lambda_T = w_T C,  Lambda_tau = w_tau C + A' Lambda_{tau+1} A,
    dV/dA = -2 sum_{tau=0}^{T-1} Lambda_{tau+1} A X_tau,
    dV/dtheta = G' dV/dA - 2 R theta sum_tau w_tau X_tau.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edtorch.model.models import Model
from edtorch.model.noise import Noise
from edtorch.policy.policies import GainedPolicy
from edtorch.shapes import ActionCost, CrossCost, Gains, Inputs, Rows, Squares, StateCost
from edtorch.types import Belief, Parameters
from edtorch.value.linear.loop import closed, linear_loop, loop_cost, priced_actions
from edtorch.value.unroll import ValueGradient


def second_moments(
    A: Squares, start: Squares, noise: Squares, steps: int
) -> tuple[Float[Tensor, "{steps+1} B n n"], Float[Tensor, "{steps} B n n"]]:
    """X_0..X_T ``[T + 1, B, n, n]`` and the products A X_0..A X_{T-1} ``[T, B, n, n]``.

    A, start X_0 and noise nu ``[B, n, n]``.
    """
    moments, products = [start], []
    transposed = A.mT
    for _ in range(steps):
        products.append(torch.bmm(A, moments[-1]))
        moments.append(torch.baddbmm(noise, products[-1], transposed))
    return torch.stack(moments), torch.stack(products)


def moment_value_and_gradient(
    drift: Squares,
    G: Inputs,
    theta: Gains,
    start: Belief,
    noise: Squares,
    *,
    state_cost: StateCost,
    action_cost: ActionCost | None,
    weights: Float[Tensor, " T"],
    cross: CrossCost | None = None,
) -> tuple[Rows, Gains]:
    """V = -sum_tau w_tau tr((Q + theta'R theta) X_tau) and dV/dtheta.

    A = I + drift + G theta; drift ``[B, n, n]``, G ``[B, n, m]``, theta ``[B, m, n]``, start: a
    belief of ``[B, n]``, noise nu over one step ``[B, n, n]``, state_cost Q ``[n, n]``, action_cost
    R ``[m, m]`` or None for zero, weights w ``[T]``, cross N ``[n, m]`` or None for zero (2
    s'N a is a cost as well).  Returns V ``[B]`` and its gradient ``[B, m, n]``.
    """
    factors = weights.tolist()
    steps = len(factors)
    cost = loop_cost(state_cost, action_cost, cross, theta)
    A = closed(drift, G, theta)
    transposed = A.mT
    first = start.mean.unsqueeze(-1) * start.mean.unsqueeze(-2) + start.cov
    moments, products = second_moments(A, first, noise, steps)
    weighted = (moments[1:] * weights.view(-1, 1, 1, 1)).sum(0)
    value = -(cost * weighted).sum((-1, -2))
    adjoint = factors[-1] * cost
    through = torch.bmm(adjoint, products[-1])
    for tau in range(steps - 1, 0, -1):
        adjoint = torch.baddbmm(cost, torch.bmm(transposed, adjoint), A, beta=factors[tau - 1])
        through = torch.baddbmm(through, adjoint, products[tau - 1])
    gradient = -2 * torch.bmm(G.mT, through)
    return value, priced_actions(gradient, action_cost, cross, theta, weighted)


@dataclass(frozen=True)
class LinearMoment:
    """A ``ValuePath`` for linear model and policy, quadratic reward, constant noise, first order.

    noise: the rule for nu~, a constant one; start_cov: covariance of the belief that the unroll
    starts from, ``[n, n]``; the rest as in ``LinearMeanOnly``.
    """

    model: Model
    policy: GainedPolicy
    dt: float
    noise: Noise
    start_cov: Tensor
    weights: Tensor
    state_cost: Tensor
    action_cost: Tensor | None
    cross: Tensor | None = None
    augmented: bool = False
    needs_autograd: bool = False

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``edtorch.value.unroll.ValuePath``; ValueError if the closed loop is not linear."""
        loop = linear_loop(self.model, self.policy, model, policy, self.dt, self.augmented)
        nu = self.model.noise_over(self.noise.covariance(noise, state), self.dt)
        start = Belief(loop.start(state), loop.square(self.start_cov).expand(loop.drift.shape))
        value, gradient = moment_value_and_gradient(
            loop.drift,
            loop.G,
            loop.theta,
            start,
            loop.square(nu),
            state_cost=self.state_cost,
            action_cost=self.action_cost,
            weights=self.weights,
            cross=self.cross,
        )
        return ValueGradient(value, self.policy.of_gain(loop.gain(gradient)))
