"""A reward of one's own, a saturating one, and a small neural network for a policy.

python examples/own_reward_and_policy.py

After 10 s of experience, with a fall or two, the network holds the pole in all fresh episodes.
"""

import runpy
from pathlib import Path

import torch
from torch import Tensor, nn

import edtorch

Pole = runpy.run_path(str(Path(__file__).with_name("own_simulator.py")))["Pole"]


def near_upright(state: Tensor, action: Tensor) -> Tensor:
    """0 for the pole upright and at rest, -1 far from it: states ``[*batch, 2]`` in rad, rad/s."""
    angle, rate = state.unbind(-1)
    distance = (angle / 0.3) ** 2 + (rate / 1.5) ** 2
    return torch.exp(-0.5 * distance) - 1


class MLP(nn.Module):
    """From a scaled state to a scaled action."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Linear(8, 1))

    def forward(self, state: Tensor) -> Tensor:
        """The action ``[*batch, 1]``."""
        return self.layers(state)


FASTER = ("unroll.horizon=20", "schedule.often=0", "schedule.every=4")
"""A module is differentiated step by step, which takes its time: an update at every fourth tick."""


def main(seconds: float = 10.0, seeds: int = 4) -> dict[str, list[float | None]]:
    """Learn; returns the figures of fresh episodes."""
    run = edtorch.learn(
        Pole(),
        reward=near_upright,
        policy=MLP(),
        seconds=seconds,
        seeds=seeds,
        overrides=FASTER,
    )
    return run.evaluate(episodes=10)


if __name__ == "__main__":
    print(main())
