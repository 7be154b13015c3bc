"""Cardea: an arm of five joints on a self-balancing base, as a domain to learn in (paper, §5).

The robot and its physics are in ``sims.cardea.physics``, the arm's geometry in ``sims.cardea.arm``.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property, lru_cache, partial

import numpy as np
import torch
from torch import Tensor

from sims.base import Measure, Outcome, Quantity, Spec, Words, expect_action
from sims.cardea.arm import HIGH, LOW, slant, wrist
from sims.cardea.physics import JOINTS, URDF, Robot, StepArguments, pybullet, robot, step_rows
from sims.cardea.poses import STOPS, check_start, draw_goal, draw_start, goal_angles
from sims.kinematics import Chain
from sims.workers import Workers

__all__ = ["LIMITS", "STOPS", "Cardea", "Trouble", "slant", "wrist"]

LIMITS = (40.0, 40.0, 20.0, 3.0, 1.5)
"""Greatest torque of each joint of the arm, N m (estimates)."""

_LIMITS = torch.tensor(LIMITS, dtype=torch.float64)
_STOPS = torch.tensor(STOPS, dtype=torch.float64)

_Q, _DQ, _GOAL = slice(0, 5), slice(7, 12), slice(14, 19)
_TILT = 5
_SEEN, _APPLIED, _CLOCK, _TROUBLE = 19, slice(19, 24), 24, 25

# Divisors that bring the components to order one; they are also what the policy gradient of the
# paper's section 5 wants: base and rates matter less than joint errors.
_SCALE = (1.0,) * 5 + (0.2, 1.0) + (1 / 0.3,) * 5 + (0.5, 2.0) + (1.0,) * 5
_POSITIONS = (*JOINTS, "tilt", "x")
_STATE = (
    *_POSITIONS,
    *(f"{name}_rate" for name in _POSITIONS),
    *(f"goal_{name}" for name in JOINTS),
)
_ACTION = tuple(f"{name}_torque" for name in JOINTS)
_UNIT = ("rad",) * 6 + ("m",) + ("rad/s",) * 6 + ("m/s",) + ("rad",) * 5
_RATE_OF = dict(zip(_STATE[7:14], _POSITIONS, strict=True))


MEASURES = (
    Measure(
        "joint_error_rad", "error of the joints", "rad", "lower", median="joint_error_median_rad"
    ),
    Measure("joint_speed_rad_s", "speed of the joints", "rad/s", "lower"),
    Measure("wrist_error_cm", "distance of the wrist", "cm", "lower"),
    Measure("level_error_deg", "slant of the hand", "degrees", "lower"),
)
WORDS = Words("crash", "crashes", "reach", "reaches", "crashed", "reached")


class Trouble(IntEnum):
    """What ended an episode before its time, beside a joint stop and the tilt."""

    NONE = 0
    CONTACT = 1
    """The arm touched the robot."""
    TORQUE = 2
    """A torque was no finite number; the robot was left where it was."""
    LOST = 3
    """The process that computed the step died of it twice; the robot was left where it was."""


@dataclass(frozen=True)
class Cardea:
    """Bring the arm to a given pose and hold it there, on a base that balances by itself.

    Observation (angles of the joints in order from shoulder to hand; none wraps, there are stops):

    ===== =========================== ======= ======== ========================================
    No.   name                        unit    divisor  meaning
    ===== =========================== ======= ======== ========================================
    0-4   shoulder_yaw,               rad     1        angles of the joints; a positive pitch
          shoulder_pitch, elbow,                       lowers what follows, all 0 is the arm
          wrist_pitch, wrist_roll                      stretched forward
    5     tilt                        rad     .2       of the body, positive forward
    6     x                           m       1        of the base, forward
    7-11  ``<joint>_rate``            rad/s   1/.3
    12    tilt_rate                   rad/s   .5
    13    x_rate                      m/s     2
    14-18 ``goal_<joint>``            rad     1        wanted angles of the joints
    ===== =========================== ======= ======== ========================================

    Action: ``<joint>_torque``, N m, within the limits (40, 40, 20, 3, 1.5), which are the divisors.

    Start: base upright and still at 0; joints at rest, uniform within ``cardea_arm.LOW`` and
    ``HIGH``, drawn again until the pose has ``clearance``.  Goal: a wrist position, uniform within
    x .12 to .55 m, |z| <= .45 m and .55 m from the shoulder, with a level hand, drawn again until
    joint angles within the ranges do it with ``clearance``.  The two uniform numbers of a restart
    are the seeds, one of the start, one of the goal.

    End: FAILED when the arm touches the robot (looked for at the end of each step), a joint is
    past its stop, |tilt| > ``max_tilt``, or a torque is not finite.  After ``time_limit``:
    SUCCEEDED if the mean of |q - g| is below ``reached_error`` and that of the joints' speeds below
    ``reached_speed``, else TIMED_OUT.  A row that has ended stays as it is until it is restarted.

    Disturbance: Gaussian, on each torque, with a standard deviation of ``torque_noise`` times its
    limit, anew in each step; then torques are clipped to the limits, always.

    A full state is ``[*batch, 26]``: the observation, the torques that the last step really applied
    (5), the seconds of the episode, and its ``Trouble``.  It is all that there is: any state may be
    stepped at any time, and the same state, torques and uniforms give the same digits.

    Arguments: ``dt``, ``physics_dt``: s per step and per physics step, a divisor of it;
    ``time_limit`` in s; ``torque_noise``: share of the limits; ``start``: joint angles in rad to
    start from, ``goal``: wrist position in m to go to, from the shoulder, in the body's frame
    (None: drawn); ``clearance`` in m; ``max_tilt`` in rad; ``reached_error`` in rad;
    ``reached_speed`` in rad/s; ``workers``: processes that share the rows of a step, with the same
    digits (0: none, the fastest below some fifty rows); ``state_scale``,
    ``action_scale``: divisors by name where others are wanted.
    """

    dt: float = 0.02
    physics_dt: float = 0.004
    time_limit: float = 2.0
    torque_noise: float = 0.02
    start: Sequence[float] | None = field(default=None, hash=False)
    goal: Sequence[float] | None = field(default=None, hash=False)
    clearance: float = 0.03
    max_tilt: float = 0.5
    reached_error: float = 0.1
    reached_speed: float = 0.2
    workers: int = 0
    state_scale: Mapping[str, float] = field(default_factory=dict, hash=False)
    action_scale: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Refuse impossible arguments, and a Python without PyBullet."""
        pybullet()
        for name in ("dt", "physics_dt", "time_limit", "max_tilt"):
            _expect(name, getattr(self, name), "a finite number above 0", lambda x: x > 0)
        for name in ("torque_noise", "clearance", "reached_error", "reached_speed"):
            _expect(name, getattr(self, name), "a finite number, 0 or more", lambda x: x >= 0)
        if not isinstance(self.workers, int) or isinstance(self.workers, bool) or self.workers < 0:
            raise ValueError(f"workers={self.workers!r}: expected a whole number, 0 or more")
        if not math.isclose(self.dt / self.physics_dt, self._substeps, rel_tol=1e-9):
            raise ValueError(
                f"physics_dt={self.physics_dt}: expected a whole fraction of dt, {self.dt} s"
            )
        if self.dt > self.time_limit:
            raise ValueError(f"dt={self.dt} s: expected at most time_limit, {self.time_limit} s")
        for argument, given, known in (
            ("state_scale", self.state_scale, _STATE),
            ("action_scale", self.action_scale, _ACTION),
        ):
            for name, value in given.items():
                if name not in known:
                    raise ValueError(f"{argument}={name!r}: expected names of {', '.join(known)}")
                _expect(f"{argument}.{name}", value, "a finite number above 0", lambda x: x > 0)
        if self.start is not None:
            check_start(self._robot, self.start)
        if self.goal is not None:
            goal_angles(self._robot, self.goal, self.clearance)

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        return self._spec

    @cached_property
    def _spec(self) -> Spec:
        scale = dict(zip(_STATE, _SCALE, strict=True)) | dict(self.state_scale)
        action_scale = dict(zip(_ACTION, LIMITS, strict=True)) | dict(self.action_scale)
        return Spec(
            name="cardea",
            state=tuple(
                Quantity(name, unit, scale[name], rate_of=_RATE_OF.get(name, ""))
                for name, unit in zip(_STATE, _UNIT, strict=True)
            ),
            action=tuple(
                Quantity(name, "N m", action_scale[name], -limit, limit)
                for name, limit in zip(_ACTION, LIMITS, strict=True)
            ),
            dt=self.dt,
            time_limit=self.time_limit,
            disturbance_dim=5,
            reset_dim=2,
            clip_action=True,
            headline="shoulder_pitch",
            goal=_STATE[_GOAL],
            tracked=_STATE[_Q],
            measures=MEASURES,
            words=WORDS,
            survival=False,
            can_fail=True,
        )

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, 26]``; uniforms ``[*batch, 2]`` seed start and goal."""
        seeds = uniforms.reshape(-1, 2).tolist()
        rows = [[*self._start_angles(a), *self._goal_angles(b)] for a, b in seeds]
        angles = torch.tensor(rows, dtype=torch.float64).reshape(*uniforms.shape[:-1], 10)
        return self.at_rest(angles[..., :5], angles[..., 5:])

    def at_rest(self, start: Tensor, goal: Tensor) -> Tensor:
        """States ``[*batch, 26]`` with the joints at rest at ``start`` ``[*batch, 5]`` and wanted
        at ``goal`` ``[*batch, 5]``, rad, the base upright at 0."""
        state = torch.zeros(*start.shape[:-1], 26, dtype=torch.float64)
        state[..., _Q], state[..., _GOAL] = start, goal
        return state

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        new = state.clone()
        if bool(mask.any()):
            new[mask] = self.initial(uniforms[mask])
        return new

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``dt`` later; action ``[*batch, 5]`` in N m; uniforms ``[*batch, 5]``."""
        expect_action(state, action, len(LIMITS))
        # The least uniform number, 0, would be noise without bound.
        noise = torch.special.ndtri(uniforms.clamp(min=2.0**-54)) * self._noise
        torque = torch.clamp(action + noise, -_LIMITS, _LIMITS)
        new = state.reshape(-1, 26).clone()
        torques = torque.reshape(-1, 5)
        going = self._sound(new) & self._in_time(new)
        # Of the action: clipping makes a limit of infinity.
        usable = action.reshape(-1, 5).isfinite().all(-1)
        if len(new) and bool((going & usable).all()):
            # The usual case, without looking for rows: that would take as long as the physics.
            new = self._moved(new, torques, list(range(len(new))))
            new[:, _CLOCK] += self.dt
            return new.reshape(state.shape)
        for k in (going & ~usable).nonzero()[:, 0].tolist():
            self._warn(k, "a torque is not finite: its episode ends as a failure")
            new[k, _TROUBLE] = int(Trouble.TORQUE)
        rows = (going & usable).nonzero()[:, 0]
        if len(rows):
            new[rows] = self._moved(new[rows], torques[rows], rows.tolist())
        new[going, _CLOCK] += self.dt
        return new.reshape(state.shape)

    def observe(self, state: Tensor) -> Tensor:
        """What a learner sees, ``[*batch, 19]``, in the units of ``spec``."""
        return state[..., :_SEEN]

    def applied(self, state: Tensor) -> Tensor:
        """Torques ``[*batch, 5]``, N m, of the last step, with the noise, as clipped."""
        return state[..., _APPLIED]

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the robot moved, bool ``[*batch]``: neither a torque without a number nor a
        process that died kept it where it was."""
        trouble = state[..., _TROUBLE]
        return (trouble != int(Trouble.TORQUE)) & (trouble != int(Trouble.LOST))

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each row as int64 ``[*batch]``, the time limit included."""
        sound, in_time = self._sound(state), self._in_time(state)
        if bool((sound & in_time).all()):
            return torch.full(sound.shape, int(Outcome.RUNNING))
        reached = (_joint_error(state) < self.reached_error) & (
            _joint_speed(state) < self.reached_speed
        )
        verdict = torch.where(reached, int(Outcome.SUCCEEDED), int(Outcome.TIMED_OUT))
        verdict = torch.where(in_time, int(Outcome.RUNNING), verdict)
        return torch.where(sound, verdict, int(Outcome.FAILED))

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished episodes at their end, each ``[*batch]``.

        joint_error_rad, joint_speed_rad_s: means over the joints of |q - g| and |dq|.
        wrist_error_cm: distance of the wrist from where the goal has it, and level_error_deg: angle
        of the hand from level, both in the body's frame.
        """
        q, goal = final[..., _Q], final[..., _GOAL]
        return {
            "joint_error_rad": _joint_error(final),
            "joint_speed_rad_s": _joint_speed(final),
            "wrist_error_cm": 100 * (wrist(q) - wrist(goal)).square().sum(-1).sqrt(),
            "level_error_deg": slant(q).rad2deg(),
        }

    def lost(self, state: Tensor) -> Tensor:
        """Whether an episode ended because its worker processes died, bool ``[*batch]``."""
        return state[..., _TROUBLE] == int(Trouble.LOST)

    def inverse_dynamics(self, state: Tensor, acceleration: Tensor) -> Tensor:
        """Torques ``[*batch, 5]``, N m, that give the joints ``acceleration`` ``[*batch, 5]``,
        rad/s^2, at the beginning of a step, by the true dynamics; not clipped."""
        rows = state.reshape(-1, state.shape[-1])[:, :14].tolist()
        wanted = acceleration.detach().reshape(-1, 5).numpy()
        torques = [
            self._robot.inverse_dynamics(row, a) for row, a in zip(rows, wanted, strict=True)
        ]
        return torch.from_numpy(np.stack(torques)).reshape(acceleration.shape)

    def baselines(self) -> dict[str, Callable[[Tensor], Tensor]]:
        """The controllers of ``sims.cardea.baselines``."""
        from sims.cardea.baselines import YARDSTICKS

        return {name: partial(control, self) for name, control in YARDSTICKS.items()}

    def chain(self) -> Chain:
        """The arm's joints, from the body to the hand, whose origin is the wrist's centre."""
        return Chain(URDF, "body", "hand", low=LOW, high=HIGH)

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[240, 320, 3]``) of the robot in the last state of ``trail``
        ``[T, 26]``; a red ball is where the wrist should be."""
        from sims.cardea.picture import frame

        return frame(trail[-1])

    def _in_time(self, state: Tensor) -> Tensor:
        # Half a step of tolerance: the sum is rounded.
        return state[..., _CLOCK] < self.time_limit - self.dt / 2

    def _sound(self, state: Tensor) -> Tensor:
        # A comparison with NaN counts as failure.
        return (state.abs() <= self._bounds).all(-1)

    @cached_property
    def _noise(self) -> Tensor:
        return self.torque_noise * _LIMITS

    @cached_property
    def _bounds(self) -> Tensor:
        """Of the magnitudes in a sound state ``[26]``: everything is finite, at least."""
        bounds = torch.full((26,), torch.finfo(torch.float64).max, dtype=torch.float64)
        bounds[_Q], bounds[_TILT], bounds[_TROUBLE] = _STOPS, self.max_tilt, 0.0
        return bounds

    @property
    def _substeps(self) -> int:
        return max(1, round(self.dt / self.physics_dt))

    @property
    def _robot(self) -> Robot:
        return robot(self.physics_dt)

    def _moved(self, state: Tensor, torque: Tensor, numbers: list[int]) -> Tensor:
        """The rows ``[N, 26]``, whose numbers are ``numbers``, a step later, their clocks aside."""
        moved = self._move(numbers, state[:, :14].tolist(), torque.tolist())
        kept = (state[:, _GOAL], torque, state[:, _CLOCK, None])
        return torch.cat((moved[:, :14], *kept, moved[:, 14:]), -1)

    def _move(
        self, numbers: list[int], states: list[list[float]], torques: list[list[float]]
    ) -> Tensor:
        """The next states ``[N, 14]`` of the rows ``numbers``, with the ``Trouble`` of each as a
        fifteenth column (what ``Robot.step`` says of touching is CONTACT or NONE)."""
        dt, substeps = self.physics_dt, self._substeps
        rows: list[StepArguments] = [
            (dt, substeps, *row) for row in zip(states, torques, strict=True)
        ]
        if self.workers == 0:
            return torch.tensor(step_rows(rows), dtype=torch.float64)
        moved = []
        results = workers(self.workers).map(rows)
        for number, state, result in zip(numbers, states, results, strict=True):
            if result is None:
                text = "two processes died of its step: its episode ends as a failure"
                self._warn(number, text)
                result = [*state, float(Trouble.LOST)]
            moved.append(result)
        return torch.tensor(moved, dtype=torch.float64)

    def _start_angles(self, uniform: float) -> Sequence[float]:
        if self.start is not None:
            return self.start
        return draw_start(self._robot, uniform, self.clearance)

    def _goal_angles(self, uniform: float) -> Sequence[float]:
        if self.goal is not None:
            return goal_angles(self._robot, self.goal, self.clearance)
        return draw_goal(self._robot, uniform, self.clearance)

    def _warn(self, row: int, what: str) -> None:
        warnings.warn(f"cardea: row {row}: {what}", RuntimeWarning, stacklevel=3)


def workers(count: int) -> Workers[StepArguments, list[float]]:
    """The ``count`` processes that all the sims of this one share."""
    return _workers_of(count, os.getpid())


@lru_cache
def _workers_of(count: int, process: int) -> Workers[StepArguments, list[float]]:
    return Workers(step_rows, count)


def _joint_error(state: Tensor) -> Tensor:
    return (state[..., _Q] - state[..., _GOAL]).abs().mean(-1)


def _joint_speed(state: Tensor) -> Tensor:
    return state[..., _DQ].abs().mean(-1)


def _expect(name: str, value: float, expected: str, holds: Callable[[float], bool]) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and holds(value)):
        raise ValueError(f"{name}={value!r}: expected {expected}")
