"""Readings that are late: which action each of them belongs to.

A reading that comes in ``d`` ticks late shows what the action of ``d`` ticks ago did.  Paired with
the action of its own tick it teaches a model of something else; acted upon as it is, it is answered
too late, and a loop that is stable without the delay need not be with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.shapes import Actions, States
from edtorch.types import Parameters, select


@dataclass(frozen=True)
class Delay:
    """A known delay of ``ticks``, a whole number, 0 for none.

    Memory, per learner: ``under_way`` ``[B, ticks, m]``, the last actions, of which no reading has
    come in yet, the oldest first; ``known`` ``[B]`` int64, how many of them this episode has had,
    at most ``ticks``.
    """

    ticks: int

    def __post_init__(self) -> None:
        if self.ticks < 0:
            raise ValueError(f"delay={self.ticks}: expected a whole number of ticks, 0 or more")

    def initial(self, action: Actions) -> Parameters:
        """Nothing is under way; action ``[B, m]``, for its shape."""
        size, m = action.shape
        known = torch.zeros(size, dtype=torch.int64, device=action.device)
        return {"under_way": action.new_zeros(size, self.ticks, m), "known": known}

    def push(self, memory: Parameters, action: Tensor) -> tuple[Tensor, Tensor, Parameters]:
        """After a tick that applied ``action`` ``[B, m]``: the action that led to the reading that
        came in, ``[B, m]``; whether there was one, bool ``[B]``; the new memory."""
        actions = torch.cat([memory["under_way"], action.unsqueeze(-2)], dim=-2)
        there = memory["known"] >= self.ticks
        known = (memory["known"] + 1).clamp(max=self.ticks)
        return actions[:, 0], there, {"under_way": actions[:, 1:], "known": known}

    def ahead(
        self, memory: Parameters, state: States, move: Callable[[Tensor, Tensor], Tensor]
    ) -> States:
        """The state ``[B, n]`` of the last reading, carried on to now by the actions under way.

        move: from state ``[B, n]`` and action ``[B, m]`` to the state a tick later.
        """
        for place in range(self.ticks):
            acted = place >= self.ticks - memory["known"]
            state = select(acted, move(state, memory["under_way"][:, place]), state)
        return state
