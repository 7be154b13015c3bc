"""What Cardea's learners are measured against: controllers that know the true dynamics, or part.

Each gives torques ``[*batch, 5]``, N m, not clipped, for full states ``[*batch, 26]`` of a
``sims.cardea.Cardea``, by name in ``YARDSTICKS``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from sims.base import Invertible, Sim, spec_index

STIFFNESS, DAMPING = 50.0, 14.0
"""Of computed torque: acceleration wanted for each rad of error and rad/s, critically damped."""

PD_STIFFNESS = (20.0, 30.0, 15.0, 3.0, 1.0)
"""Of the PD controllers, N m/rad."""
PD_DAMPING = (2.0, 3.0, 1.2, 0.2, 0.04)
"""N m s/rad: more makes the arm, when it stands upright and its yaw inertia is tiny, swing up
between two control steps."""


class Arm(Sim, Invertible, Protocol):
    """An arm that offers its inverse dynamics (``sims.cardea.cardea.Cardea``)."""


def _parts(cardea: Arm, state: Tensor) -> tuple[Tensor, Tensor]:
    """Errors g - q and rates dq ``[*batch, 5]``."""
    spec, seen = cardea.spec, cardea.observe(state)
    rates = {quantity.rate_of: quantity.name for quantity in spec.state}
    q = seen[..., spec_index(spec, spec.tracked)]
    goal = seen[..., spec_index(spec, spec.goal)]
    return goal - q, seen[..., spec_index(spec, [rates[name] for name in spec.tracked])]


def computed_torque(cardea: Arm, state: Tensor) -> Tensor:
    """The torques that make each joint a critically damped spring to its goal, exactly."""
    error, rate = _parts(cardea, state)
    return cardea.inverse_dynamics(state, STIFFNESS * error - DAMPING * rate)


def pd(cardea: Arm, state: Tensor) -> Tensor:
    """A spring and a damper on each joint, and nothing known of the robot."""
    error, rate = _parts(cardea, state)
    stiffness, damping = (torch.tensor(gain).to(error) for gain in (PD_STIFFNESS, PD_DAMPING))
    return stiffness * error - damping * rate


def pd_gravity(cardea: Arm, state: Tensor) -> Tensor:
    """``pd`` and the torques that would hold the arm where it is, at rest."""
    still = state.clone()
    still[..., 7:14] = 0
    return pd(cardea, state) + cardea.inverse_dynamics(still, torch.zeros_like(state[..., :5]))


def nothing(cardea: Arm, state: Tensor) -> Tensor:
    """No torque."""
    return torch.zeros_like(state[..., :5])


YARDSTICKS: dict[str, Callable[[Arm, Tensor], Tensor]] = {
    "computed_torque": computed_torque,
    "pd_gravity": pd_gravity,
    "pd": pd,
    "nothing": nothing,
}
"""By name."""
