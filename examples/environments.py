"""Twelve environments, each as a new user would write it; regulation solves half of them.

python examples/environments.py [NAME ...]
"""

import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

import edtorch


def inverted_pendulum(**more: Any) -> edtorch.Run:
    """Held at the first attempt."""
    return edtorch.learn(
        "InvertedPendulum-v5",
        names=["position", "angle", "speed", "rate"],
        target={"position": 0.0, "angle": 0.0},
        **{"seconds": 8, **more},
    )


def inverted_double_pendulum(**more: Any) -> edtorch.Run:
    """Held by some seeds, with the angles declared: a cosine is not linear in anything."""
    return edtorch.learn(
        "InvertedDoublePendulum-v5",
        names=["x", "sin1", "sin2", "cos1", "cos2", "v", "rate1", "rate2", "force"],
        angles={"angle1": ("cos1", "sin1"), "angle2": ("cos2", "sin2")},
        target={"x": 0.0, "angle1": 0.0, "angle2": 0.0},
        **{"seconds": 20, **more},
    )


def pendulum(**more: Any) -> edtorch.Run:
    """Needs a swing-up, which no linear policy does."""
    return edtorch.learn(
        "Pendulum-v1",
        names=["cos", "sin", "rate"],
        angles={"angle": ("cos", "sin")},
        target={"angle": 0.0},
        **{"seconds": 30, **more},
    )


def mountain_car(**more: Any) -> edtorch.Run:
    """Needs to swing as well; its steps have no length in seconds, hence ``dt=1``."""
    return edtorch.learn(
        "MountainCarContinuous-v0",
        names=["position", "speed"],
        target={"position": 0.45},
        dt=1.0,
        termination="success",
        **{"seconds": 3000, **more},
    )


def reacher(**more: Any) -> edtorch.Run:
    """The fingertip's distance from its target is among the observations."""
    return edtorch.learn(
        "Reacher-v5",
        names=["cos1", "cos2", "sin1", "sin2", "goal_x", "goal_y", "rate1", "rate2", "dx", "dy"],
        target={"dx": 0.0, "dy": 0.0},
        weights={"rate1": 0.01, "rate2": 0.01},
        **{"seconds": 20, **more},
    )


def pusher(**more: Any) -> edtorch.Run:
    """The arm must meet the object: the linear model knows nothing of contact."""
    return edtorch.learn("Pusher-v5", **{"seconds": 50, **more})


def swimmer(**more: Any) -> edtorch.Run:
    """A speed cannot be held without a rhythm, which a linear policy does not have."""
    return edtorch.learn(
        "Swimmer-v5",
        names=["tip", "joint1", "joint2", "vx", "vy", "tip_rate", "rate1", "rate2"],
        target={"vx": 0.5},
        **{"seconds": 80, **more},
    )


def lunar_lander(**more: Any) -> edtorch.Run:
    """Touching down ends the episode: by the return, landed from 200 points on."""
    return edtorch.learn(
        "LunarLanderContinuous-v3",
        names=["x", "y", "vx", "vy", "angle", "rate", "left", "right"],
        target={"x": 0.0, "y": 0.0, "vx": 0.0, "vy": -0.1, "angle": 0.0},
        dt=0.02,
        **{"seconds": 60, **more},
    )


def _dm_control(name: str) -> gymnasium.Env[Any, Any]:
    import shimmy

    gymnasium.register_envs(shimmy)
    return gymnasium.wrappers.FlattenObservation(gymnasium.make(f"dm_control/{name}-v0"))


def cartpole_balance(**more: Any) -> edtorch.Run:
    """dm_control's, through shimmy; its dictionary of observations has to be flattened."""
    return edtorch.learn(
        lambda: _dm_control("cartpole-balance"),
        names=["position", "cos", "sin", "speed", "rate"],
        angles={"angle": ("cos", "sin")},
        target={"position": 0.0, "angle": 0.0},
        **{"seconds": 20, **more},
    )


def ball_in_cup(**more: Any) -> edtorch.Run:
    """Catching needs a swing."""
    return edtorch.learn(
        lambda: _dm_control("ball_in_cup-catch"),
        names=["cup_x", "cup_z", "ball_x", "ball_z", "cup_vx", "cup_vz", "ball_vx", "ball_vz"],
        **{"seconds": 40, **more},
    )


class CartPole(gymnasium.Env[np.ndarray, np.ndarray]):
    """A cart of 1 kg with a pole of 1 m and 0.1 kg, as in Gymnasium but with a force of choice."""

    def __init__(self) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (4,), np.float64)
        self.action_space = spaces.Box(-10.0, 10.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        """Near upright."""
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-0.05, 0.05, 4)
        return self.state.copy(), {}

    def step(self, action):
        """0.02 s later."""
        _, v, angle, rate = self.state
        force = (float(action[0]) + 0.05 * rate**2 * np.sin(angle)) / 1.1
        turn = 9.8 * np.sin(angle) - np.cos(angle) * force
        turn /= 0.5 * (4 / 3 - 0.1 * np.cos(angle) ** 2 / 1.1)
        push = force - 0.05 * turn * np.cos(angle) / 1.1
        self.state = self.state + 0.02 * np.array([v, push, rate, turn])
        fallen = bool(abs(self.state[0]) > 2.4 or abs(self.state[2]) > 0.21)
        return self.state.copy(), 1.0, fallen, False, {}


def cart_pole(**more: Any) -> edtorch.Run:
    """Half a metre to the right of where it starts."""
    return edtorch.learn(
        CartPole,
        names=["x", "v", "angle", "rate"],
        target={"x": 0.5, "angle": 0.0},
        dt=0.02,
        time_limit=10.0,
        termination="failure",
        **{"seconds": 20, **more},
    )


class Quadrotor(gymnasium.Env[np.ndarray, np.ndarray]):
    """One of 1 kg that moves in a vertical plane, with two rotors of 0 to 10 N."""

    def __init__(self) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (6,), np.float64)
        self.action_space = spaces.Box(0.0, 10.0, (2,), np.float64)

    def reset(self, *, seed=None, options=None):
        """Within 0.1 m of the origin."""
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-0.1, 0.1, 6)
        return self.state.copy(), {}

    def step(self, action):
        """0.02 s later; it has crashed beyond 2 m or 1 rad."""
        pitch, thrust = self.state[2], float(action[0] + action[1])
        forces = [-thrust * np.sin(pitch), thrust * np.cos(pitch) - 9.81]
        self.state[3:] += 0.02 * np.array([*forces, 10 * float(action[1] - action[0])])
        self.state[:3] += 0.02 * self.state[3:]
        crashed = bool(np.abs(self.state[:2]).max() > 2 or abs(self.state[2]) > 1)
        return self.state.copy(), -float(np.square(self.state[:2]).sum()), crashed, False, {}


def quadrotor(**more: Any) -> edtorch.Run:
    """It is not told the thrust that carries its weight."""
    return edtorch.learn(
        Quadrotor,
        names=["x", "z", "pitch", "vx", "vz", "rate"],
        target={"x": 0.0, "z": 0.0},
        dt=0.02,
        time_limit=10.0,
        termination="failure",
        **{"seconds": 20, **more},
    )


ENVIRONMENTS: dict[str, Callable[..., edtorch.Run]] = {
    f.__name__: f
    for f in (
        inverted_pendulum,
        inverted_double_pendulum,
        pendulum,
        mountain_car,
        reacher,
        pusher,
        swimmer,
        lunar_lander,
        cartpole_balance,
        ball_in_cup,
        cart_pole,
        quadrotor,
    )
}


def main(*names: str, **more: Any) -> None:
    """Learn in each, and print the figures of fresh episodes, one number per seed."""
    for name in names or ENVIRONMENTS:
        run = ENVIRONMENTS[name](**{"seeds": 4, "progress": False, **more})
        for figure, values in run.evaluate(episodes=20).items():
            print(name, figure, [v if v is None else round(v, 3) for v in values])


if __name__ == "__main__":
    main(*sys.argv[1:])
