"""Systems with an event: a ball that bounces, a rod that hits a stop, a mass that runs into one."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.transform.guarded import Event
from sims.rows import TORCH
from sims.tasks.pendulum_swing_up import derivative_over
from sims.tasks.stop_pendulum import LOW

GRAVITY = 9.81


def ball(restitution: float) -> Event:
    """(height, speed): it leaves the ground with that part of its speed."""
    keep = torch.tensor([1.0, -restitution]).double()
    return Event(lambda s: s[..., 0], lambda s: s * keep, _fall, _fall)


def cart(speed: float) -> Event:
    """(position, speed): it runs into a wall at 0, where it stays; only a cart of this speed."""
    keep, move = torch.tensor([1.0, 0.0]).double(), torch.tensor([speed, 0.0]).double()
    return Event(
        lambda s: s[..., 0], lambda s: s * keep, lambda s: move.expand_as(s), torch.zeros_like
    )


def rod() -> Event:
    """(angle, rate, torque): the stop pendulum at its lower stop, under a torque that is held."""
    keep = torch.tensor([1.0, 0.0, 1.0]).double()
    return Event(lambda s: s[..., 0] - LOW, lambda s: s * keep, _swing, _pressed)


def _fall(state: Tensor) -> Tensor:
    speed = state[..., 1]
    return torch.stack([speed, torch.full_like(speed, -GRAVITY)], dim=-1)


_FREE = derivative_over(TORCH)


def _swing(state: Tensor) -> Tensor:
    angle, rate, torque = state.unbind(-1)
    return torch.stack([*_FREE((angle, rate), (torque,)), torch.zeros_like(torque)], dim=-1)


def _pressed(state: Tensor) -> Tensor:
    rate, rise, still = _swing(state).unbind(-1)
    return torch.stack([rate, rise.clamp(min=0.0), still], dim=-1)
