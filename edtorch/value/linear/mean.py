r"""The value of a linear closed loop under a quadratic reward, exactly, by recursion.

With s' = A s, A = F + G theta, and r = -s'(Q + theta'R theta)s the unroll is a chain of matrix
products, and its gradient follows from the adjoint

    q_tau = -2 w_tau (Q + theta'R theta) s_tau,
    lambda_T = q_T,  lambda_tau = q_tau + A' lambda_{tau+1},
    dV/dA = sum_tau lambda_tau s_{tau-1}',
    dV/dtheta = G' dV/dA - 2 R theta sum_tau w_tau s_tau s_tau'.

Both sequences are built by doubling: with the powers A, A^2, A^4, ... all T states come from about
log2(T) products (s_{j+k} = A^k s_j), and so do all adjoints (lambda_tau += A'^k lambda_{tau+k};
after the step with k each lambda_tau holds 2k terms).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edtorch.model.models import Model
from edtorch.policy.policies import GainedPolicy
from edtorch.shapes import ActionCost, CrossCost, Gains, Inputs, Rows, Squares, StateCost, States
from edtorch.types import Parameters
from edtorch.value.linear.loop import closed, linear_loop, loop_cost, priced_actions
from edtorch.value.unroll import ValueGradient


def powers_of_two(matrix: Tensor, steps: int) -> list[Tensor]:
    """A, A^2, A^4, ... up to the largest power of two below ``steps``; matrix ``[B, n, n]``."""
    powers = [matrix]
    while 2 ** len(powers) < steps:
        powers.append(torch.bmm(powers[-1], powers[-1]))
    return powers


def forward_states(
    powers: list[Tensor], start: States, steps: int
) -> Float[Tensor, "B n {steps+1}"]:
    """s_0..s_T of s' = A s as columns ``[B, n, T + 1]``, from start s_0 ``[B, n]``."""
    states = start.unsqueeze(-1)
    for power in powers:
        # Columns 0..k-1 become k..2k-1; the last power may need only some of them.
        some = states[..., : steps + 1 - states.shape[-1]]
        states = torch.cat([states, torch.bmm(power, some)], dim=-1)
    if states.shape[-1] <= steps:
        states = torch.cat([states, torch.bmm(powers[0], states[..., -1:])], dim=-1)
    return states


def adjoint_states(powers: list[Tensor], sources: Float[Tensor, "B n T"]) -> Float[Tensor, "B n T"]:
    """lambda_1..lambda_T with lambda_tau = q_tau + A' lambda_{tau+1}, from q ``[B, n, T]``."""
    adjoints = sources
    for exponent, power in enumerate(powers):
        shift = 2**exponent
        head, tail = adjoints.split([adjoints.shape[-1] - shift, shift], dim=-1)
        carried = torch.baddbmm(head, power.mT, adjoints[..., shift:])
        adjoints = torch.cat([carried, tail], dim=-1)
    return adjoints


def mean_value_and_gradient(
    drift: Squares,
    G: Inputs,
    theta: Gains,
    start: States,
    *,
    state_cost: StateCost,
    action_cost: ActionCost | None,
    weights: Float[Tensor, " T"],
    cross: CrossCost | None = None,
) -> tuple[Rows, Gains]:
    """V = -sum_tau w_tau s_tau'(Q + theta'R theta)s_tau along s' = A s, and dV/dtheta.

    A = I + drift + G theta; drift ``[B, n, n]``, G ``[B, n, m]``, theta ``[B, m, n]``, start
    ``[B, n]``, state_cost Q ``[n, n]``, action_cost R ``[m, m]`` or None for zero, weights w
    ``[T]``, cross N ``[n, m]`` or None for zero (2 s'N a is a cost as well).  Returns V ``[B]`` and
    its gradient ``[B, m, n]``.
    """
    steps = len(weights)
    cost = loop_cost(state_cost, action_cost, cross, theta)
    powers = powers_of_two(closed(drift, G, theta), steps)
    states = forward_states(powers, start, steps)
    before, after = states[..., :-1], states[..., 1:]
    pull = torch.bmm(cost, after) * weights
    value = -(pull * after).sum((-1, -2))
    adjoints = adjoint_states(powers, -2 * pull)
    # Sums over time, not a matrix product: a library's product of this size takes another path for
    # a batch of one, and the digits of a learner would depend on its company.
    through = (adjoints.unsqueeze(-2) * before.unsqueeze(-3)).sum(-1)
    gradient = torch.bmm(G.mT, through)
    if action_cost is not None or cross is not None:
        second_moment = ((after * weights).unsqueeze(-2) * after.unsqueeze(-3)).sum(-1)
        gradient = priced_actions(gradient, action_cost, cross, theta, second_moment)
    return value, gradient


@dataclass(frozen=True)
class LinearMeanOnly:
    """A ``ValuePath`` for linear model and policy, quadratic reward, mean-only transform.

    dt: seconds of one step of the unroll; costs as in ``mean_value_and_gradient``; augmented:
    whether they are of (1, state).
    """

    model: Model
    policy: GainedPolicy
    dt: float
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
        value, gradient = mean_value_and_gradient(
            loop.drift,
            loop.G,
            loop.theta,
            loop.start(state),
            state_cost=self.state_cost,
            action_cost=self.action_cost,
            weights=self.weights,
            cross=self.cross,
        )
        return ValueGradient(value, self.policy.of_gain(loop.gain(gradient)))
