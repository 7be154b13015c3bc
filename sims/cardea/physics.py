"""Cardea's physics: one PyBullet world with the robot of ``cardea.urdf`` and its balance.

It is used as a function: the joints are put where the state says before every step, and no contact
forces are computed (an episode ends at the first touch, which distance queries notice).  So the
next state depends on nothing but the state and the torques, to the last digit.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import os
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

URDF = Path(__file__).with_name("cardea.urdf")

JOINTS = ("shoulder_yaw", "shoulder_pitch", "elbow", "wrist_pitch", "wrist_roll")
COORDINATES = (*JOINTS, "tilt", "slide")
"""Order of all positions and velocities here; the slide is the position x of the base."""

GRAVITY = 9.81
WHEEL_RADIUS = 0.24
BALANCE = (31.62, 433.5, 62.58, 112.0)
"""Wheel torque for each unit of x, tilt and their rates, N m: LQR with the arm locked, for costs
(20, 200, 10, 20) of these and .02 of the torque."""
WHEEL_LIMIT = 150.0
"""Greatest wheel torque, N m."""

_ARM, _BASE = ("upper_arm", "forearm", "hand"), ("axle", "body")
# Neighbours are left out: they meet at their joint, and hand and forearm when the wrist is bent by
# 90 degrees.
MAY_TOUCH = (*((arm, base) for arm in _ARM for base in _BASE), ("hand", "upper_arm"))
"""The pairs of links that must not touch."""


def pybullet() -> ModuleType:
    """PyBullet, or one line that says how to get it."""
    if importlib.util.find_spec("pybullet") is None:
        raise ModuleNotFoundError(
            "the Cardea domain needs PyBullet, which is not installed; expected:"
            " pip install -c constraints.txt -e '.[cardea]'"
        )
    return importlib.import_module("pybullet")


StepArguments = tuple[float, int, list[float], list[float]]
"""s per physics step, how many of them, a state, torques: the arguments of ``step_rows``."""

_robots: dict[tuple[int, float], Robot] = {}


def robot(physics_dt: float) -> Robot:
    """This process's robot: nothing is left in it between two calls, so one serves everybody."""
    # A forked process must not use its parent's world.
    key = (os.getpid(), physics_dt)
    if key not in _robots:
        _robots[key] = Robot(physics_dt)
    return _robots[key]


def step_rows(rows: list[StepArguments]) -> list[list[float]]:
    """``Robot.step`` of each row."""
    return [robot(dt).step(state, torques, steps) for dt, steps, state, torques in rows]


class Robot:
    """Cardea in a PyBullet world of its own.

    A state is ``[14]``: the positions of ``COORDINATES`` (rad, rad, m), then their rates.

    Arguments: ``physics_dt``: s per physics step; ``urdf``: the file to load; ``balance``: whether
    the Segway's controller acts.
    """

    def __init__(
        self, physics_dt: float = 0.004, *, urdf: Path = URDF, balance: bool = True
    ) -> None:
        """Load the robot."""
        self._bullet = bullet = pybullet()
        self._client: int = bullet.connect(bullet.DIRECT)
        self._gains = BALANCE if balance else (0.0, 0.0, 0.0, 0.0)
        at = {"physicsClientId": self._client}
        bullet.setGravity(0, 0, -GRAVITY, **at)
        bullet.setTimeStep(physics_dt, **at)
        flags = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_USE_SELF_COLLISION
        self._body: int = bullet.loadURDF(str(urdf), useFixedBase=True, flags=flags, **at)
        info = [bullet.getJointInfo(self._body, j, **at) for j in range(len(COORDINATES))]
        joints = {row[1].decode(): j for j, row in enumerate(info)}
        links = {row[12].decode(): j for j, row in enumerate(info)}
        self._joints = [joints[name] for name in COORDINATES]
        self._damping = np.array([info[j][6] for j in self._joints])
        self._pairs = [(links[a], links[b]) for a, b in MAY_TOUCH]
        everything = range(-1, len(info))
        for j in everything:
            # PyBullet's own .04 of each; its limits would be stiff springs, where an episode ends.
            bullet.changeDynamics(self._body, j, linearDamping=0, angularDamping=0, **at)
            for k in everything:
                bullet.setCollisionFilterPair(self._body, self._body, j, k, 0, **at)
        for j in self._joints:
            bullet.changeDynamics(self._body, j, jointLowerLimit=-1e6, jointUpperLimit=1e6, **at)
            # A motor that holds the joint is on by default.
            bullet.setJointMotorControl2(self._body, j, bullet.VELOCITY_CONTROL, force=0, **at)

    def close(self) -> None:
        """Give the world back."""
        self._bullet.disconnect(physicsClientId=self._client)

    def put(self, state: Sequence[float]) -> None:
        """Set all positions and rates."""
        self._bullet.resetJointStatesMultiDof(
            self._body,
            self._joints,
            [[value] for value in state[:7]],
            [[value] for value in state[7:]],
            physicsClientId=self._client,
        )

    def read(self) -> list[float]:
        """All positions and rates."""
        rows = self._bullet.getJointStates(self._body, self._joints, physicsClientId=self._client)
        return [row[0] for row in rows] + [row[1] for row in rows]

    def advance(self, torques: Sequence[float], steps: int) -> None:
        """``steps`` physics steps with ``torques`` ``[5]`` on the arm, N m, and the balance."""
        bullet, client, base = self._bullet, self._client, self._joints[5:]
        forces = [*torques, 0.0, 0.0]
        for _ in range(steps):
            tilt, slide = bullet.getJointStates(self._body, base, physicsClientId=client)
            wheel = self.wheel_torque(slide[0], tilt[0], slide[1], tilt[1])
            forces[5:] = -wheel, wheel / WHEEL_RADIUS
            # PyBullet forgets the torques after each step.
            bullet.setJointMotorControlArray(
                self._body,
                self._joints,
                bullet.TORQUE_CONTROL,
                forces=forces,
                physicsClientId=client,
            )
            bullet.stepSimulation(physicsClientId=client)

    def wheel_torque(self, x: float, tilt: float, dx: float, dtilt: float) -> float:
        """The balance's torque on the wheels, N m; they push the base forward with it."""
        k = self._gains
        wheel = k[0] * x + k[1] * tilt + k[2] * dx + k[3] * dtilt
        return min(max(wheel, -WHEEL_LIMIT), WHEEL_LIMIT)

    def step(self, state: Sequence[float], torques: Sequence[float], steps: int) -> list[float]:
        """The state after ``steps`` physics steps, and 1 if the arm touches then, else 0, ``[15]``;
        a function of its arguments alone."""
        self.put(state)
        self.advance(torques, steps)
        return [*self.read(), float(self.touching())]

    def touching(self, margin: float = 0.0) -> bool:
        """Whether two links that must not touch are within ``margin``, m, of one another."""
        closest, body, client = self._bullet.getClosestPoints, self._body, self._client
        # Queries return every pair of shapes within the margin that they are given.
        return any(
            point[8] <= margin
            for a, b in self._pairs
            for point in closest(body, body, margin, a, b, physicsClientId=client)
        )

    def clear(self, angles: Sequence[float], margin: float) -> bool:
        """Whether the arm at ``angles`` ``[5]``, upright, keeps ``margin``, m, everywhere."""
        self.put([*angles, *(0.0,) * 9])
        # The shapes follow the joints only now.
        self._bullet.performCollisionDetection(physicsClientId=self._client)
        return not self.touching(margin)

    def mass_matrix(self, state: Sequence[float]) -> Array:
        """M ``[7, 7]`` in the order of ``COORDINATES``."""
        chain = self._in_chain(state[:7])
        matrix = self._bullet.calculateMassMatrix(self._body, chain, physicsClientId=self._client)
        return np.array(matrix)[np.ix_(self._joints, self._joints)]

    def bias(self, state: Sequence[float]) -> Array:
        """h ``[7]``: what gravity, velocities and damping need, M ddq + h = forces."""
        chain, rates = self._in_chain(state[:7]), self._in_chain(state[7:])
        forces = self._bullet.calculateInverseDynamics(
            self._body, chain, rates, [0.0] * len(chain), physicsClientId=self._client
        )
        return np.array(forces)[self._joints] + self._damping * np.asarray(state[7:])

    def inverse_dynamics(self, state: Sequence[float], acceleration: Array) -> Array:
        """Torques ``[5]`` that accelerate the arm's joints by ``acceleration`` ``[5]``, rad/s^2.

        The base is not ours to command: its two accelerations a_b follow from the balance's forces
        f_b,  M_bb a_b = f_b - h_b - M_ba a,  and with them  u = M_aa a + M_ab a_b + h_a.
        """
        matrix, bias = self.mass_matrix(state), self.bias(state)
        wheel = self.wheel_torque(state[6], state[5], state[13], state[12])
        base = np.array([-wheel, wheel / WHEEL_RADIUS]) - bias[5:] - matrix[5:, :5] @ acceleration
        base_acceleration = np.linalg.solve(matrix[5:, 5:], base)
        return matrix[:5, :5] @ acceleration + matrix[:5, 5:] @ base_acceleration + bias[:5]

    def energy(self, state: Sequence[float]) -> float:
        """Kinetic and potential energy, J."""
        rates = np.asarray(state[7:])
        self.put(state)
        at = {"physicsClientId": self._client}
        height = 0.0
        for link in self._joints:
            mass = self._bullet.getDynamicsInfo(self._body, link, **at)[0]
            place = self._bullet.getLinkState(self._body, link, computeForwardKinematics=1, **at)
            height += mass * place[0][2]
        return float(0.5 * rates @ self.mass_matrix(state) @ rates + GRAVITY * height)

    def _in_chain(self, values: Sequence[float]) -> list[float]:
        chain = [math.nan] * len(self._joints)
        for joint, value in zip(self._joints, values, strict=True):
            chain[joint] = float(value)
        return chain
