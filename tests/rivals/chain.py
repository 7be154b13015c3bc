"""A walk on a few places in a row, of which the last one is the goal: its Q is known."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from edtorch.rivals.batch import Transitions
from sims.base import Outcome, Quantity, Spec

PLACES = 3
ACTIONS = torch.tensor([[-1.0], [1.0]], dtype=torch.float64)


class Chain:
    """State: place 0 ... PLACES, observed as it is; action: -1 or 1; the first place is a wall, the
    last one ends the episode, and place -1 does not exist.  Starts anywhere before the last."""

    traceable: ClassVar[bool] = True
    spec = Spec(
        name="chain",
        state=(Quantity("place", "1"),),
        action=(Quantity("move", "1", low=-1.0, high=1.0),),
        dt=1.0,
        time_limit=50.0,
        disturbance_dim=0,
        reset_dim=1,
        clip_action=True,
        headline="place",
    )

    def initial(self, uniforms: Tensor) -> Tensor:
        return (uniforms * PLACES).floor()

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        return torch.where(mask[..., None], self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        return (state + action).clamp(0, PLACES)

    def observe(self, state: Tensor) -> Tensor:
        return state

    def outcome(self, state: Tensor) -> Tensor:
        return (state[..., 0] >= PLACES).long() * int(Outcome.SUCCEEDED)

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        return {}


def optimal_values(discount: float) -> Tensor:
    """Q* ``[PLACES, 2]`` of the reward "squares lost", s^2 - s'^2, times -1: by value iteration on
    the table."""
    place = torch.arange(PLACES, dtype=torch.float64)
    after = (place[:, None] + ACTIONS[:, 0]).clamp(0, PLACES)
    gained = after.square() - place.square()[:, None]
    value = torch.zeros(PLACES + 1, dtype=torch.float64)
    q = gained
    for _ in range(2000):
        q = gained + discount * value[after.long()]
        value[:PLACES] = q.amax(1)
    return q


def every_transition() -> Transitions:
    """Each place with each action, once."""
    state = torch.arange(PLACES, dtype=torch.float64).repeat_interleave(2)[:, None]
    action = ACTIONS.repeat(PLACES, 1)
    after = (state + action).clamp(0, PLACES)
    no = torch.zeros(len(state), dtype=torch.bool)
    return Transitions(
        state=state,
        action=action,
        next_state=after,
        dt=torch.ones(len(state), dtype=torch.float64),
        episode=torch.arange(len(state)),
        terminated=(after >= PLACES)[:, 0],
        truncated=no,
        failed=no,
    )
