"""A simulator of one's own, as functions of tensors: a population of learners in one process.

python examples/own_simulator.py
"""

import torch
from torch import Tensor

import edtorch
from sims.base import Outcome, Quantity, Spec
from sims.conformance import check

SPEC = Spec(
    name="pole",
    state=(
        Quantity("angle", "rad", scale=0.5),
        Quantity("rate", "rad/s", scale=2.0, rate_of="angle"),
    ),
    action=(Quantity("torque", "N m", scale=5.0, low=-5.0, high=5.0),),
    dt=0.02,
    time_limit=10.0,
    disturbance_dim=1,
    reset_dim=2,
    clip_action=True,
    headline="angle",
    survival=True,  # to last until the time limit is a success
)


class Pole:
    """Hold a pole of one metre upright by a torque; it has fallen beyond 0.6 rad."""

    spec = SPEC
    traceable = True

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, 2]`` from uniforms ``[*batch, 2]`` in [0, 1)."""
        return 0.1 * (2 * uniforms - 1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """New starts where ``mask`` ``[*batch]``."""
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state one tick later."""
        angle, rate = state.unbind(-1)
        push = action[..., 0] + 2 * (2 * uniforms[..., 0] - 1)
        rate = rate + 0.02 * (9.81 * angle.sin() + push)
        return torch.stack([angle + 0.02 * rate, rate], dim=-1)

    def observe(self, state: Tensor) -> Tensor:
        """All of the state."""
        return state

    def outcome(self, state: Tensor) -> Tensor:
        """FAILED where it has fallen."""
        fallen = state[..., 0].abs() > 0.6
        return torch.where(fallen, int(Outcome.FAILED), int(Outcome.RUNNING))

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Where an episode ended."""
        return {"final_angle_rad": final[..., 0]}


def main(seconds: float = 8.0, seeds: int = 8) -> dict[str, list[float | None]]:
    """Check the simulator, then learn in it; returns the figures of fresh episodes."""
    check(Pole())
    run = edtorch.learn(Pole(), target={"angle": 0.0}, seconds=seconds, seeds=seeds)
    return run.evaluate(episodes=10)


if __name__ == "__main__":
    print(main())
