"""The bicycle as a domain to learn in: what the rider sees, when a ride ends, what it measures.

``step`` is the pure physics (``sims.bicycle_physics``); ``Bicycle`` makes it a ``Sim``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from sims.angles import atan2
from sims.base import Outcome, Quantity, Spec
from sims.bicycle_optimum import shortest_time, steady_handlebar
from sims.bicycle_physics import (
    RANDLOV,
    STATE,
    Integrator,
    Physics,
    explicit_euler,
    semi_implicit,
    step,
)

__all__ = [
    "GOAL",
    "HANDLEBAR_FIRST",
    "RANDLOV",
    "STATE",
    "Bicycle",
    "Physics",
    "angle_to_goal",
    "explicit_euler",
    "semi_implicit",
    "step",
]

GOAL = (1000.0, 0.0)
"""Where the bicycle is to go, m; it starts with its back tyre at the origin."""

HANDLEBAR_FIRST = ("handlebar", "handlebar_rate", "lean", "lean_rate", "angle_to_goal")
"""The order of features in the older literature; for use with ``sims.base.spec_index``."""

_STATE_SCALE = {
    "lean": math.pi / 15,
    "lean_rate": 0.5,
    "handlebar": 0.5,
    "handlebar_rate": 2.0,
    "angle_to_goal": math.pi,
    "lean_acceleration": 1.0,
}
_STATE_UNIT = {
    "lean": "rad",
    "lean_rate": "rad/s",
    "handlebar": "rad",
    "handlebar_rate": "rad/s",
    "angle_to_goal": "rad",
    "lean_acceleration": "rad/s^2",
}
_ACTION_SCALE = {"handlebar_torque": 2.0, "displacement": 0.02}
_ACTION_UNIT = {"handlebar_torque": "N m", "displacement": "m"}
_ACTION_BOUND = {"handlebar_torque": 2.0, "displacement": 0.02}


def angle_to_goal(state: Tensor) -> Tensor:
    """Angle ``[*batch]`` in (-pi, pi] from the frame's direction to that from the front tyre to the
    goal, positive if the goal is on the left; state ``[*batch, 10]``.

    It is a true angle.  The C program has a surrogate, the cosine minus one or its absolute value,
    whose slope vanishes on course.
    """
    return _angle_to_goal(state.movedim(-1, 0).contiguous())


def _angle_to_goal(components: Tensor) -> Tensor:
    xf, yf, xb, yb = components[6:].unbind(0)
    ux, uy, wx, wy = xf - xb, yf - yb, GOAL[0] - xf, GOAL[1] - yf
    return atan2(ux * wy - uy * wx, ux * wx + uy * wy)


@dataclass(frozen=True)
class Bicycle:
    """Ride a bicycle, without falling, to a goal a kilometre away (Randløv and Alstrøm, ICML 1998).

    Observation:

    ==== ================= ======= ======== ==================================================
    No.  name              unit    divisor  meaning (angles positive to the left)
    ==== ================= ======= ======== ==================================================
    0    lean              rad     pi/15    of the frame from the vertical
    1    lean_rate         rad/s   0.5
    2    handlebar         rad     0.5      from straight ahead; stops at +-1.3963
    3    handlebar_rate    rad/s   2
    4    angle_to_goal     rad     pi       in (-pi, pi], positive if the goal is on the left
    5    lean_acceleration rad/s^2 1        in the step just made; if ``lean_acceleration``
    ==== ================= ======= ======== ==================================================

    Action:

    ==== ================= ======= ======== ==================================================
    No.  name              unit    divisor  meaning
    ==== ================= ======= ======== ==================================================
    0    handlebar_torque  N m     2        in [-2, 2]
    1    displacement      m       0.02     of the rider from the frame's plane, [-0.02, 0.02]
    ==== ================= ======= ======== ==================================================

    Start: upright and straight at the origin, heading uniform in [``start_heading_low``,
    ``start_heading_high``] (psi, 0 along +y).  The defaults are any direction; 0 and 0 are the C
    program's start, with the goal 90 degrees to the right; -pi/2 is straight at the goal.

    End: FAILED when the lean exceeds 12 degrees (or a number is no longer finite), SUCCEEDED when
    the front tyre is within ``goal_radius`` of (1000, 0) m, both together counting as a fall, and
    TIMED_OUT after ``time_limit``.

    Disturbance: the rider's displacement is off by up to ``noise`` either way, uniformly, anew in
    each step and after the action's clipping.

    A full state is that of ``sims.bicycle_physics.step``, ``[*batch, 10]``.

    Arguments: ``dt`` in s; ``time_limit`` in s; ``start_heading_low``, ``start_heading_high`` in
    rad; ``goal_radius`` in m; ``clip_action``: whether actions are held within their bounds;
    ``noise`` in m; ``lean_acceleration``: whether it is observed; ``state_scale`` and
    ``action_scale``: divisors by name where others than those above are wanted; ``physics``: the
    constants of the bicycle; ``integrate``: ``semi_implicit`` or ``explicit_euler``.
    """

    dt: float = 0.01
    time_limit: float = 1000.0
    start_heading_low: float = -math.pi
    start_heading_high: float = math.pi
    goal_radius: float = 10.0
    clip_action: bool = True
    noise: float = 0.02
    lean_acceleration: bool = False
    state_scale: Mapping[str, float] = field(default_factory=dict, hash=False)
    action_scale: Mapping[str, float] = field(default_factory=dict, hash=False)
    physics: Physics = RANDLOV
    integrate: Integrator = semi_implicit
    traceable: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        for name in ("dt", "time_limit", "goal_radius"):
            _expect(name, getattr(self, name), "a finite number above 0", lambda x: x > 0)
        _expect("noise", self.noise, "a finite number, 0 or more (m)", lambda x: x >= 0)
        for name in ("start_heading_low", "start_heading_high"):
            _expect(name, getattr(self, name), "within [-pi, pi]", lambda x: abs(x) <= math.pi)
        if self.start_heading_low > self.start_heading_high:
            raise ValueError(
                f"start_heading_low={self.start_heading_low}: expected at most start_heading_high,"
                f" {self.start_heading_high}"
            )
        if self.dt > self.time_limit:
            raise ValueError(f"dt={self.dt} s: expected at most time_limit, {self.time_limit} s")
        for argument, given, known in (
            ("state_scale", self.state_scale, _STATE_SCALE),
            ("action_scale", self.action_scale, _ACTION_SCALE),
        ):
            for name, value in given.items():
                if name not in known:
                    raise ValueError(f"{argument}={name!r}: expected names of {', '.join(known)}")
                _expect(f"{argument}.{name}", value, "a finite number above 0", lambda x: x > 0)

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        return self._spec

    @cached_property
    def _steady_handlebar(self) -> Tensor:
        return steady_handlebar(physics=self.physics)

    @cached_property
    def _spec(self) -> Spec:
        scale = _STATE_SCALE | dict(self.state_scale)
        names = list(_STATE_SCALE) if self.lean_acceleration else list(_STATE_SCALE)[:-1]
        period = {"angle_to_goal": 2 * math.pi}
        limit = {"lean": float(self.physics.omega_max)}
        action_scale = _ACTION_SCALE | dict(self.action_scale)
        return Spec(
            name="bicycle",
            state=tuple(
                Quantity(
                    name,
                    _STATE_UNIT[name],
                    scale[name],
                    period=period.get(name, 0.0),
                    limit=limit.get(name, math.inf),
                )
                for name in names
            ),
            action=tuple(
                Quantity(name, _ACTION_UNIT[name], action_scale[name], -bound, bound)
                for name, bound in _ACTION_BOUND.items()
            ),
            dt=self.dt,
            time_limit=self.time_limit,
            disturbance_dim=1,
            reset_dim=1,
            clip_action=self.clip_action,
            headline="angle_to_goal",
        )

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, 10]``, with headings from uniforms ``[*batch, 1]``."""
        low, high = self.start_heading_low, self.start_heading_high
        psi = low + (high - low) * uniforms[..., 0].contiguous()
        zero = torch.zeros_like(psi)
        east, north = -psi.sin() * self.physics.l, psi.cos() * self.physics.l
        rows = (zero, zero, zero, zero, zero, psi, east, north, zero, zero)
        return torch.stack(rows).movedim(0, -1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        return torch.where(mask[..., None], self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``dt`` later; action ``[*batch, 2]`` in N m and m; uniforms ``[*batch, 1]``."""
        disturbance = uniforms[..., 0] * (2 * self.noise) - self.noise
        return step(
            state, action, disturbance, physics=self.physics, integrate=self.integrate, dt=self.dt
        )

    def observe(self, state: Tensor) -> Tensor:
        """What the rider sees, ``[*batch, 5]`` or ``[*batch, 6]``, in the units of ``spec``."""
        components = state.movedim(-1, 0).contiguous()
        theta, theta_dot, omega, omega_dot, omega_ddot = components[:5].unbind(0)
        rows = (omega, omega_dot, theta, theta_dot, _angle_to_goal(components))
        if self.lean_acceleration:
            rows = (*rows, omega_ddot)
        # The batch last in memory, as in the state: compiled, a whole tick is then one pass.
        return torch.stack(rows).movedim(0, -1)

    def outcome(self, state: Tensor) -> Tensor:
        """FAILED, SUCCEEDED or RUNNING as int64 ``[*batch]``; a fall is looked for first."""
        # The sum is finite only if every component is; a comparison with NaN is false.
        upright = (state[..., 2].abs() <= self.physics.omega_max) & (state.sum(-1).abs() < math.inf)
        east, north = state[..., 6] - GOAL[0], state[..., 7] - GOAL[1]
        arrived = east * east + north * north <= self.goal_radius * self.goal_radius
        return torch.where(
            upright,
            arrived.long() * int(Outcome.SUCCEEDED),
            int(Outcome.FAILED),
        )

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished rides, each ``[*batch]``; seconds ``[*batch]``.

        goal_time_s: how long the ride took, NaN if it did not end at the goal.  path_length_m:
        the length of the path of the tyres, each of which goes v dt in every step, whatever the
        rider does.  shortest_time_s: about the least that the way from ``start`` can take
        (``sims.bicycle_optimum``).
        """
        succeeded = self.outcome(final) == int(Outcome.SUCCEEDED)
        return {
            "goal_time_s": torch.where(succeeded, seconds, math.nan),
            "path_length_m": seconds * self.physics.v,
            "shortest_time_s": shortest_time(
                start,
                goal=GOAL,
                goal_radius=self.goal_radius,
                physics=self.physics,
                handlebar=self._steady_handlebar,
            ),
        }

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[270, 480, 3]``): the path from above and the rider from behind, for
        the states ``[T, 10]`` of one ride so far."""
        # Pictures need Pillow, riding does not.
        from sims.bicycle_picture import frame

        return frame(trail, goal=GOAL, goal_radius=self.goal_radius)


def _expect(name: str, value: float, expected: str, holds: Callable[[float], bool]) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and holds(value)):
        raise ValueError(f"{name}={value!r}: expected {expected}")
