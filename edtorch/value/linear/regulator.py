r"""Riccati's recursion on the learned model, as a way to improve a policy.

The gradient says which way is up; where the loop is linear and the reward quadratic, the top itself
is known: the first gain of the finite-horizon regulator,

    P_T = Q,  theta_tau = -(R + G' P_{tau+1} G)^-1 (G' P_{tau+1} F + N'),
    P_tau = Q + F' P_{tau+1} (F + G theta_tau) + N theta_tau.

Constants of the model and linear terms of the reward are those of the state (1, s).  The direction
towards the gain replaces the gradient; ``edtorch.policy.steps.FullStep`` goes all the way.  It
regulates with certainty equivalence: neither noise nor start matter to the gain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from edtorch.linalg import solve_positive
from edtorch.model.models import Model
from edtorch.policy.policies import GainedPolicy
from edtorch.rewards import QuadraticForm, Reward, quadratic_form_of
from edtorch.shapes import ActionCost, CrossCost, Gains, Inputs, Squares, StateCost
from edtorch.types import Parameters
from edtorch.value.linear.loop import linear_loop
from edtorch.value.unroll import Horizon, ValueGradient


def first_gain(
    drift: Squares,
    G: Inputs,
    state_cost: StateCost,
    action_cost: ActionCost,
    horizon: Horizon,
    cross: CrossCost | None = None,
) -> tuple[Gains, Squares]:
    """theta_0 ``[B, m, n]`` and P_0 ``[B, n, n]`` for F = I + drift ``[B, n, n]``, G ``[B, n, m]``,
    Q ``[n, n]`` and R ``[m, m]`` positive definite; cross N ``[n, m]``, None for zero."""
    discount = horizon.discount**horizon.unit
    N = G.new_zeros(G.shape[1:]) if cross is None else horizon.unit * cross
    P = (horizon.unit * state_cost).expand(drift.shape)
    R = (horizon.unit * action_cost).expand(G.shape[0], *action_cost.shape)
    theta = torch.zeros_like(G.mT)
    for _ in range(horizon.steps):
        forward = P + P @ drift
        pull = discount * (G.mT @ forward) + N.mT
        theta = -solve_positive(R + discount * (G.mT @ (P @ G)), pull)
        back = forward + P @ (G @ theta)
        P = horizon.unit * state_cost + discount * (back + drift.mT @ back) + N @ theta
        P = 0.5 * (P + P.mT)
    return theta, P


@dataclass(frozen=True)
class Regulator:
    """A ``ValuePath`` whose direction leads to the regulator of the model as it is.

    value: that of the regulator from the belief, noise left out.  An action cost above zero, and a
    policy with a constant where the model has one or the reward a target (ValueError otherwise).
    """

    model: Model
    policy: GainedPolicy
    reward: Reward
    horizon: Horizon
    start_cov: Tensor
    needs_autograd: bool = False
    form: QuadraticForm = field(init=False)
    state_cost: Tensor = field(init=False)
    cross: Tensor | None = field(init=False)

    @property
    def augmented(self) -> bool:
        """Whether the costs are of (1, state)."""
        return not self.form.is_homogeneous

    @property
    def action_cost(self) -> Tensor:
        """R ``[m, m]``."""
        return self.form.action

    def __post_init__(self) -> None:
        form = quadratic_form_of(self.reward)
        if form is None:
            raise ValueError("direction=regulator: expected a quadratic reward")
        object.__setattr__(self, "form", form)
        smallest = torch.linalg.eigvalsh(form.action)[0].item()
        if not smallest > 0:
            raise ValueError("direction=regulator: expected a cost > 0 of every action (reward)")
        first = (self.model.initial([0]), self.policy.initial([0]))
        loop = linear_loop(self.model, self.policy, *first, self.horizon.dt, self.augmented)
        if loop.augmented and not loop.policy_has_constant:
            raise ValueError(
                "direction=regulator: expected a policy with a constant where the model has one or"
                " the reward a target; policy=affine"
            )
        affine = loop.augmented
        state = form.of_state if affine else form.state
        cross = form.of_both if affine else form.cross
        object.__setattr__(self, "state_cost", state)
        object.__setattr__(self, "cross", cross if bool((cross != 0).any()) else None)

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``ValuePath``; the gradient is theta_0 - theta."""
        loop = linear_loop(self.model, self.policy, model, policy, self.horizon.dt, self.augmented)
        theta, P = first_gain(
            loop.drift, loop.G, self.state_cost, self.action_cost, self.horizon, self.cross
        )
        start = loop.start(state)
        start = start.unsqueeze(-1) * start.unsqueeze(-2) + loop.square(self.start_cov)
        value = -(P * start).sum((-1, -2))
        return ValueGradient(value, self.policy.of_gain(loop.gain(theta - loop.theta)))
