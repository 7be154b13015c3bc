"""The general quadratic cost of state and action, as closed forms take it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad


@dataclass(frozen=True)
class QuadraticForm:
    """cost = s'Q s + a'R a + 2 s'N a + 2 g's + 2 h'a + c; the reward is minus that.

    state Q ``[n, n]``, action R ``[m, m]``, cross N ``[n, m]``, state_linear g ``[n]``,
    action_linear h ``[m]``, constant c ``[]``.
    """

    state: Tensor
    action: Tensor
    cross: Tensor
    state_linear: Tensor
    action_linear: Tensor
    constant: Tensor

    @property
    def is_homogeneous(self) -> bool:
        """Whether nothing is linear or constant, so that the cost is one of (s, a) alone."""
        rest = (self.state_linear, self.action_linear, self.constant)
        return not any(bool((part != 0).any()) for part in rest)

    @property
    def is_plain(self) -> bool:
        """Whether the cost is s'Q s + a'R a."""
        return self.is_homogeneous and not bool((self.cross != 0).any())

    @property
    def of_state(self) -> Tensor:
        """The cost of x = (1, s) as a matrix ``[1 + n, 1 + n]``."""
        square = pad(self.state, (1, 0, 1, 0))
        edge = torch.cat([self.constant.reshape(1), self.state_linear])
        square[0, :] = edge
        square[:, 0] = edge
        return square

    @property
    def of_both(self) -> Tensor:
        """N of x = (1, s), so that 2 x'N a is what state and action cost together,
        ``[1 + n, m]``."""
        return torch.cat([self.action_linear.unsqueeze(0), self.cross])

    def scaled(self, state: Tensor, action: Tensor) -> QuadraticForm:
        """The same cost of s / ``state`` ``[n]`` and a / ``action`` ``[m]``."""
        return QuadraticForm(
            self.state * state.unsqueeze(-1) * state,
            self.action * action.unsqueeze(-1) * action,
            self.cross * state.unsqueeze(-1) * action,
            self.state_linear * state,
            self.action_linear * action,
            self.constant,
        )
