"""An arm of known dynamics, for tests that must not need PyBullet: every coordinate a unit mass."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sims.base import Outcome, Quantity, Spec

JOINTS = ("turn", "first", "second", "third", "roll")


@dataclass(frozen=True)
class Masses:
    """Five unit inertias with a damping of .5 and gravity on the bends, on a base that swings.

    q'' = 4 u - .5 q' - (0, 2 cos q_1, cos(q_1 + q_2), 0, 0),  o'' = -4 o - 2 o' + .1 sum q''.
    The state is the observation; an episode lasts 1 s.
    """

    dt: float = 0.02
    spread: float = 0.8

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        positions = (*JOINTS, "base")
        state = [Quantity(name, "rad" if name != "base" else "m") for name in positions]
        state += [Quantity(f"{n}_rate", "rad/s", 3.0, rate_of=n) for n in positions]
        state += [Quantity(f"goal_{name}", "rad") for name in JOINTS]
        return Spec(
            name="masses",
            state=tuple(state),
            action=tuple(Quantity(f"{n}_torque", "N m", 2.0, -2.0, 2.0) for n in JOINTS),
            dt=self.dt,
            time_limit=1.0,
            disturbance_dim=5,
            reset_dim=10,
            clip_action=True,
            headline="turn",
            goal=tuple(f"goal_{name}" for name in JOINTS),
            tracked=JOINTS,
        )

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start and goal anywhere."""
        drawn = self.spread * (2 * uniforms - 1)
        zero = torch.zeros(*drawn.shape[:-1], 7, dtype=torch.float64)
        return torch.cat((drawn[..., :5], zero, drawn[..., 5:]), -1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """New starts where ``mask``."""
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """``dt`` later, exactly where accelerations are constant."""
        q, o, dq, do, goal = state.split((5, 1, 5, 1, 5), -1)
        bent = q[..., 1:3].cumsum(-1).cos() * torch.tensor([2.0, 1.0], dtype=q.dtype)
        pull = torch.nn.functional.pad(bent, (1, 2))
        push = 4 * (action + 0.1 * (uniforms - 0.5)) - 0.5 * dq - pull
        swing = -4 * o - 2 * do + 0.1 * push.sum(-1, keepdim=True)
        h = self.dt
        moved = (q + h * dq + 0.5 * h * h * push, o + h * do + 0.5 * h * h * swing)
        return torch.cat((*moved, dq + h * push, do + h * swing, goal), -1)

    def observe(self, state: Tensor) -> Tensor:
        """All of it."""
        return state

    def outcome(self, state: Tensor) -> Tensor:
        """FAILED beyond 4 rad."""
        fell = (state[..., :5].abs() > 4).any(-1)
        return torch.where(fell, int(Outcome.FAILED), int(Outcome.RUNNING))

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Error and speed of the joints at the end."""
        return {
            "joint_error_rad": (final[..., :5] - final[..., 12:]).abs().mean(-1),
            "joint_speed_rad_s": final[..., 6:11].abs().mean(-1),
        }
