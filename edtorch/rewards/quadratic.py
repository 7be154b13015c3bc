"""Quadratic rewards: costs of the deviation from a target, cross terms and linear terms."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from edtorch.rewards.form import QuadraticForm as QuadraticForm
from edtorch.shapes import Actions, Rows, States


class QuadraticReward:
    """r(s, a) = -(x'Q x + u'R u + 2 x'N u + q's + p'a), x = s - s*, u = a - a*, scaled units.

    state_cost Q ``[n, n]``, action_cost R ``[m, m]``; target s* ``[n]`` and action_target a*
    ``[m]``, cross N ``[n, m]``, state_linear q ``[n]`` and action_linear p ``[m]``, each None for
    zero.  Q and R are symmetric, and ((Q, N), (N', R)) is positive semidefinite (ValueError
    otherwise).  The paper's bicycle: Q weighs the squared angle to the goal with 1 and the squared
    lean with 10, the rest is zero (section 4).
    """

    def __init__(
        self,
        state_cost: Tensor,
        action_cost: Tensor,
        *,
        target: Tensor | None = None,
        action_target: Tensor | None = None,
        cross: Tensor | None = None,
        state_linear: Tensor | None = None,
        action_linear: Tensor | None = None,
    ) -> None:
        for name, cost in (("state_cost", state_cost), ("action_cost", action_cost)):
            if cost.ndim != 2 or cost.shape[0] != cost.shape[1]:
                raise ValueError(f"{name} has shape {tuple(cost.shape)}, expected a square matrix")
            if not torch.allclose(cost, cost.T):
                raise ValueError(f"{name} is not symmetric")
            _refuse_negative(name, cost)
        n, m = state_cost.shape[0], action_cost.shape[0]
        for name, part, shape in (
            ("target", target, (n,)),
            ("action_target", action_target, (m,)),
            ("cross", cross, (n, m)),
            ("state_linear", state_linear, (n,)),
            ("action_linear", action_linear, (m,)),
        ):
            if part is not None and tuple(part.shape) != shape:
                raise ValueError(f"{name} has shape {tuple(part.shape)}, expected {shape}")
        if cross is not None:
            both = torch.cat(
                [torch.cat([state_cost, cross], 1), torch.cat([cross.T, action_cost], 1)]
            )
            _refuse_negative("the cost of state and action with cross", both)
        self.state_cost = state_cost
        self.action_cost = action_cost
        self.target = target
        self.action_target = action_target
        self.cross = cross
        self.state_linear = state_linear
        self.action_linear = action_linear
        self.actions = m
        self.costs_actions = bool((action_cost != 0).any()) or not (
            cross is None and action_linear is None
        )

    def __call__(self, state: States, action: Actions, /) -> Rows:
        """Minus the cost, ``[*batch]``."""
        away = state if self.target is None else state - self.target
        push = action if self.action_target is None else action - self.action_target
        cost = (away @ self.state_cost * away).sum(-1)
        if self.costs_actions:
            cost = cost + (push @ self.action_cost * push).sum(-1)
        if self.cross is not None:
            cost = cost + 2 * (away @ self.cross * push).sum(-1)
        if self.state_linear is not None:
            cost = cost + (state * self.state_linear).sum(-1)
        if self.action_linear is not None:
            cost = cost + (action * self.action_linear).sum(-1)
        return -cost

    @cached_property
    def quadratic_form(self) -> QuadraticForm:
        """The cost with everything multiplied out."""
        Q, R = self.state_cost, self.action_cost
        n, m = Q.shape[0], R.shape[0]
        s = Q.new_zeros(n) if self.target is None else self.target
        a = Q.new_zeros(m) if self.action_target is None else self.action_target
        N = Q.new_zeros(n, m) if self.cross is None else self.cross
        q = Q.new_zeros(n) if self.state_linear is None else self.state_linear
        p = Q.new_zeros(m) if self.action_linear is None else self.action_linear
        return QuadraticForm(
            state=Q,
            action=R,
            cross=N,
            state_linear=q / 2 - Q @ s - N @ a,
            action_linear=p / 2 - R @ a - N.T @ s,
            constant=s @ Q @ s + a @ R @ a + 2 * (s @ N @ a),
        )


def _refuse_negative(name: str, cost: Tensor) -> None:
    smallest = torch.linalg.eigvalsh(cost)[0].item()
    if smallest < -1e-12 * cost.abs().max().item():
        raise ValueError(f"{name} has eigenvalue {smallest:.3g}, expected all >= 0")
