"""Learn to hold an environment of one's own, and use the policy.

python examples/own_env.py
"""

import gymnasium
import numpy as np
from gymnasium import spaces

import edtorch


class Balance(gymnasium.Env[np.ndarray, np.ndarray]):
    """Hold a pole of one metre upright by a torque; it has fallen beyond 0.6 rad."""

    def __init__(self) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = spaces.Box(-5.0, 5.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        """A new episode, near upright."""
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-0.1, 0.1, 2)
        return self.state.copy(), {}

    def step(self, action):
        """0.02 s later."""
        angle, rate = self.state
        rate += 0.02 * (9.81 * np.sin(angle) + float(action[0]) + self.np_random.normal())
        self.state = np.array([angle + 0.02 * rate, rate])
        return self.state.copy(), 1.0, bool(abs(self.state[0]) > 0.6), False, {}


def main(seconds: float = 8.0) -> dict[str, list[float | None]]:
    """Learn for so many simulated seconds; returns the figures of fresh episodes."""
    run = edtorch.learn(
        Balance,
        names=["angle", "rate"],
        rates={"rate": "angle"},
        target={"angle": 0.0},
        dt=0.02,
        time_limit=4.0,
        termination="failure",
        seconds=seconds,
    )
    observation, _ = Balance().reset(seed=0)
    print("action at", observation, ":", run.policy.predict(observation))
    return run.evaluate(episodes=5)


if __name__ == "__main__":
    print(main())
