r"""Riccati's recursion on the learned model, as a way to improve a policy.

The gradient says which way is up; where the loop is linear and the reward quadratic, the top itself
is known: the first gain of the finite-horizon regulator,

    P_T = Q,  theta_tau = -(R + G' P_{tau+1} G)^-1 G' P_{tau+1} F,
    P_tau = Q + F' P_{tau+1} (F + G theta_tau).

The direction towards it replaces the gradient; ``edtorch.policy.steps.FullStep`` goes all the way.
 It regulates with certainty equivalence: neither noise nor start matter to the gain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from edtorch.linalg import solve_positive
from edtorch.model.models import Model
from edtorch.policy.policies import GainedPolicy
from edtorch.rewards import QuadraticForm, Reward, quadratic_form_of
from edtorch.shapes import ActionCost, Gains, Inputs, Squares, StateCost
from edtorch.types import Parameters
from edtorch.value.linear.loop import linear_loop
from edtorch.value.unroll import Horizon, ValueGradient


def first_gain(
    drift: Squares, G: Inputs, state_cost: StateCost, action_cost: ActionCost, horizon: Horizon
) -> tuple[Gains, Squares]:
    """theta_0 ``[B, m, n]`` and P_0 ``[B, n, n]`` for F = I + drift ``[B, n, n]``, G ``[B, n, m]``,
    Q ``[n, n]`` positive semidefinite and R ``[m, m]`` positive definite."""
    discount = horizon.discount**horizon.unit
    P = (horizon.unit * state_cost).expand(drift.shape)
    R = (horizon.unit * action_cost).expand(G.shape[0], *action_cost.shape)
    theta = torch.zeros_like(G.mT)
    for _ in range(horizon.steps):
        forward = P + P @ drift
        pull = discount * (G.mT @ forward)
        theta = -solve_positive(R + discount * (G.mT @ (P @ G)), pull)
        back = forward + P @ (G @ theta)
        P = horizon.unit * state_cost + discount * (back + drift.mT @ back)
        P = 0.5 * (P + P.mT)
    return theta, P


@dataclass(frozen=True)
class Regulator:
    """A ``ValuePath`` whose direction leads to the regulator of the model as it is.

    value: that of the regulator from the belief, noise left out.  model and policy linear without a
    constant, an action cost above zero (ValueError otherwise).
    """

    model: Model
    policy: GainedPolicy
    reward: Reward
    horizon: Horizon
    start_cov: Tensor
    needs_autograd: bool = False
    form: QuadraticForm = field(init=False)

    def __post_init__(self) -> None:
        form = quadratic_form_of(self.reward)
        if form is None or not form.is_plain:
            raise ValueError(
                "direction=regulator: expected a quadratic reward of weights alone, without target,"
                " cross or linear terms"
            )
        object.__setattr__(self, "form", form)
        smallest = torch.linalg.eigvalsh(form.action)[0].item()
        if not smallest > 0:
            raise ValueError("direction=regulator: expected a cost > 0 of every action (reward)")
        first = (self.model.initial([0]), self.policy.initial([0]))
        if linear_loop(self.model, self.policy, *first, self.horizon.dt).augmented:
            raise ValueError("direction=regulator: expected model and policy without a constant")

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``ValuePath``; the gradient is theta_0 - theta."""
        loop = linear_loop(self.model, self.policy, model, policy, self.horizon.dt)
        theta, P = first_gain(loop.drift, loop.G, self.form.state, self.form.action, self.horizon)
        start = state.unsqueeze(-1) * state.unsqueeze(-2) + self.start_cov
        value = -(P * start).sum((-1, -2))
        return ValueGradient(value, self.policy.of_gain(loop.gain(theta - loop.theta)))
