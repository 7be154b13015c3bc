"""Inverse policies: from state and goal to the accelerations that are wanted (section 5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import torch
from torch import Tensor

from edtorch.inverse.layout import Layout
from edtorch.linalg import matvec

Form = Literal["error", "goal"]
"""How the goal enters the policy's features; see ``InversePolicy``."""


@dataclass(frozen=True)
class InversePolicy:
    """a = A tanh(k Theta z / A), with weights Theta ``[n, outputs]``.

    gain k; limit A in rad/s^2 (None: a = k Theta z).  Features, with the state scaled:
    form="error": z = (s, g - q, 1); form="goal": z = (s, g), the paper's.  Both are linear in state
    and goal, z = ``of_state`` s + ``of_goal`` g + ``constant``, s and g in physical units.
    """

    layout: Layout
    gain: float = 20.0
    limit: float | None = 30.0
    form: Form = "error"

    def __post_init__(self) -> None:
        if not self.gain > 0:
            raise ValueError(f"gain={self.gain}: expected a number > 0")
        if self.limit is not None and not self.limit > 0:
            raise ValueError(f"limit={self.limit}: expected a number > 0, or null")
        if self.form not in get_args(Form):
            raise ValueError(f"form={self.form}: expected one of {', '.join(get_args(Form))}")
        # Made now: a tensor that is first made inside a transform of torch.func must not leave it.
        _ = self.of_state, self.of_goal, self.constant

    @property
    def outputs(self) -> int:
        """Size of z."""
        return self.of_state.shape[0]

    @property
    def unit(self) -> float:
        """What tanh's value is multiplied with; 1 without a limit."""
        return 1.0 if self.limit is None else self.limit

    @cached_property
    def of_state(self) -> Tensor:
        """``[outputs, 2 (n + p)]``."""
        n, size = self.layout.joints, self.layout.size
        scaled = torch.diag(1 / self.layout.scale)
        rest = torch.zeros(n + 1 if self.form == "error" else n, size, dtype=torch.float64)
        if self.form == "error":
            rest[:n, :n] = -torch.eye(n)
        return torch.cat((scaled, rest))

    @cached_property
    def of_goal(self) -> Tensor:
        """``[outputs, n]``."""
        n, size = self.layout.joints, self.layout.size
        matrix = torch.zeros(self.outputs, n, dtype=torch.float64)
        matrix[size : size + n] = torch.eye(n)
        return matrix

    @cached_property
    def constant(self) -> Tensor:
        """``[outputs]``."""
        vector = torch.zeros(self.outputs, dtype=torch.float64)
        if self.form == "error":
            vector[-1] = 1
        return vector

    def regressor(self, state: Tensor, goal: Tensor) -> Tensor:
        """z ``[*batch, outputs]``; state ``[*batch, 2 (n + p)]``, goal ``[*batch, n]``."""
        of_state, of_goal = self.of_state.to(state), self.of_goal.to(state)
        return state @ of_state.mT + goal @ of_goal.mT + self.constant.to(state)

    def acceleration(self, theta: Tensor, state: Tensor, goal: Tensor) -> Tensor:
        """a ``[*batch, n]``; theta ``[*batch, n, outputs]``."""
        drive = matvec(theta, self.regressor(state, goal)) * (self.gain / self.unit)
        return drive if self.limit is None else self.limit * drive.tanh()
