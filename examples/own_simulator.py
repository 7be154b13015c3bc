"""A simulator of one's own, written once over rows: a population of learners in one process.

python examples/own_simulator.py
"""

from torch import Tensor

import edtorch
from sims.base import Outcome, Quantity, Spec
from sims.conformance import check
from sims.rows import Namespace, Rows, RowSim

FAILED, RUNNING = int(Outcome.FAILED), int(Outcome.RUNNING)

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


class Pole(RowSim):
    """Hold a pole of one metre upright by a torque; it has fallen beyond 0.6 rad."""

    spec = SPEC

    def rows(self, xp: Namespace) -> Rows:
        """Its functions, written once: torch runs them batched, numba compiles them."""

        def step(state, action, uniforms, constants):
            """The state one tick later."""
            angle, rate = state
            push = action[0] + 2 * (2 * uniforms[0] - 1)
            rate = rate + 0.02 * (9.81 * xp.sin(angle) + push)
            return angle + 0.02 * rate, rate

        def start(state, uniforms, constants):
            return 0.1 * (2 * uniforms[0] - 1), 0.1 * (2 * uniforms[1] - 1)

        return Rows(
            width=2,
            step=step,
            observe=lambda state, constants: state,
            outcome=lambda state, constants: xp.where(xp.abs(state[0]) > 0.6, FAILED, RUNNING),
            start=start,
        )

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
