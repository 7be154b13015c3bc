"""The bicycle as a domain to learn in: what the rider sees, when a ride ends, what it measures.

``step`` is the pure physics (``sims.bicycle.physics``); ``Bicycle`` makes it a ``Sim``.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sims.angles import atan2_over
from sims.base import Measure, Outcome, Quantity, Spec, Words
from sims.bicycle.life import CHANGING, DRAWN, Numbers, changed_over, factors_over, multiplied
from sims.bicycle.optimum import shortest_length, steady_handlebar
from sims.bicycle.physics import (
    RANDLOV,
    STATE,
    Integrator,
    Physics,
    Scalar,
    explicit_euler,
    semi_implicit,
    step,
    step_over,
)
from sims.bicycle.wind import Gusts, gusts_over
from sims.rows import TORCH, Function, Namespace, Rows, RowSim, unstacked

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

GOAL_RATE = Measure("goal_rate", "share that reaches the goal", "", "higher")
GOAL_TIME = Measure(
    "goal_time_s", "time to the goal", "s", "lower", successes=True, pooled="goal_time_all_s"
)
PATH_LENGTH = Measure("path_length_m", "length of path", "m", "lower", successes=True)
WORDS = Words("fall", "falls", "ride", "rides", "fell", "rode")

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


_RUNNING, _FAILED, _SUCCEEDED = map(int, (Outcome.RUNNING, Outcome.FAILED, Outcome.SUCCEEDED))

Constants = namedtuple(
    "Constants",
    (
        *Numbers._fields,
        *(f"later_{name}" for name in Numbers._fields),
        *("dt", "noise", "goal_radius", "heading_low", "heading_high", "start_lean"),
        *("start_handlebar", "spread", "change_step", "gust", "gust_steps", "gust_chance"),
    ),
)
"""The constants of ``Bicycle.rows``; ``later_``: after the change."""


def angle_to_goal(state: Tensor) -> Tensor:
    """Angle ``[*batch]`` in (-pi, pi] from the frame's direction to that from the front tyre to the
    goal, positive if the goal is on the left; state ``[*batch, 10]``.

    It is a true angle.  The C program has a surrogate, the cosine minus one or its absolute value,
    whose slope vanishes on course.
    """
    return _ANGLE_TO(unstacked(state), *GOAL)


def angle_to_over(xp: Namespace) -> Function:
    """That angle over rows: a function of the state and the goal's x and y."""
    angle, _ = atan2_over(xp)

    @xp.jit
    def angle_to(state, x, y):
        ux, uy, wx, wy = state[6] - state[8], state[7] - state[9], x - state[6], y - state[7]
        return angle(ux * wy - uy * wx, ux * wx + uy * wy)

    return angle_to


_ANGLE_TO = angle_to_over(TORCH)


@dataclass(frozen=True)
class Bicycle(RowSim):
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

    Disturbance: the rider's displacement is off by up to ``noise`` either way, drawn uniformly in
    each step and after the action's clipping.

    Harder worlds, each off by default and free to go with the others:

    * ``start_lean``, ``start_handlebar``: a start off balance, both angles uniform within these.
    * ``spread``: masses, heights, speed and wheelbase (``sims.bicycle.life.DRAWN``) drawn for each
      bicycle at the beginning of its life, uniformly within this share of ``physics`` either way;
      ``restart`` leaves them as they are, and nothing that is observed tells them.
    * ``gust``: standard deviation of the force of gusts from the side (``sims.bicycle.wind``),
      each lasting ``gust_seconds`` and coming every ``gust_every`` seconds on average.
    * ``change_at``: age of the bicycle, in seconds over all of its rides, at which the constants
      that ``change`` names take the values there, for good; where constants are drawn, times what
      was drawn.

    A full state is that of ``sims.bicycle.physics.step``, ``[*batch, 10]``, followed by what the
    harder worlds remember: the factors of the constants drawn (7), the age in steps (1), the gust's
    force and how many steps it has left (2), each where it is used.

    Arguments: ``dt`` in s; ``time_limit`` in s; ``start_heading_low``, ``start_heading_high`` in
    rad; ``goal_radius`` in m; ``clip_action``: whether actions are held within their bounds;
    ``noise`` in m; ``lean_acceleration``: whether it is observed; ``state_scale`` and
    ``action_scale``: divisors by name where others than those above are wanted; ``physics``: the
    constants of the bicycle; ``integrate``: ``semi_implicit`` or ``explicit_euler``;
    ``start_lean``, ``start_handlebar`` in rad; ``spread`` in [0, 1); ``gust`` in N;
    ``gust_seconds``, ``gust_every``, ``change_at`` in s; ``change``: values by name of ``Physics``.
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
    start_lean: float = 0.0
    start_handlebar: float = 0.0
    spread: float = 0.0
    gust: float = 0.0
    gust_seconds: float = 1.0
    gust_every: float = 5.0
    change_at: float | None = None
    change: Mapping[str, float] = field(default_factory=dict, hash=False)

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
        self._check_harder()

    def _check_harder(self) -> None:
        most = {"start_lean": self.physics.omega_max, "start_handlebar": self.physics.theta_max}
        for name, limit in most.items():
            least = float(torch.as_tensor(limit).min())
            within = f"from 0 to {least:.4f} rad, where the ride ends or the handlebar stops"
            _expect(name, getattr(self, name), within, lambda x, least=least: 0 <= x <= least)
        _expect("spread", self.spread, "at least 0 and below 1", lambda x: 0 <= x < 1)
        _expect("gust", self.gust, "a finite number, 0 or more (N)", lambda x: x >= 0)
        for name in ("gust_seconds", "gust_every"):
            _expect(name, getattr(self, name), "a finite number above 0", lambda x: x > 0)
        if self.gust > 0 and not self.dt <= self.gust_seconds <= self.gust_every:
            raise ValueError(
                f"gust_seconds={self.gust_seconds}: expected dt, {self.dt} s, at least and"
                f" gust_every, {self.gust_every} s, at most"
            )
        for name, value in self.change.items():
            if name not in CHANGING:
                raise ValueError(f"change={name!r}: expected names of {', '.join(CHANGING)}")
            _expect(f"change.{name}", value, "a finite number above 0", lambda x: x > 0)
        if self.change_at is None:
            return
        _expect("change_at", self.change_at, "a finite number, 0 or more (s)", lambda x: x >= 0)
        if not self.change:
            raise ValueError(
                f"change_at={self.change_at}: expected a change at that time, such as change.v=5"
            )

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        return self._spec

    @cached_property
    def _steady_handlebar(self) -> Tensor:
        return steady_handlebar(physics=self.physics)

    @cached_property
    def _gusts(self) -> Gusts | None:
        if self.gust == 0:
            return None
        return Gusts(self.gust, self.gust_seconds, self.gust_every, self.dt)

    @cached_property
    def _places(self) -> dict[str, slice]:
        """Slices of a full state that hold the components beside the bicycle itself."""
        widths = {
            "factors": len(DRAWN) if self.spread > 0 else 0,
            "age": 1 if self.change_at is not None else 0,
            "gust": 2 if self._gusts is not None else 0,
        }
        places, first = {}, len(STATE)
        for name, width in widths.items():
            if width:
                places[name] = slice(first, first + width)
                first += width
        return places

    @property
    def width(self) -> int:
        """How many components a full state has."""
        return max((place.stop for place in self._places.values()), default=len(STATE))

    @property
    def lasting(self) -> tuple[int, ...]:
        """Which components of a full state last a life (``sims.base.Lasting``): what was drawn for
        the bicycle, and its age."""
        lasting = [self._places[name] for name in ("factors", "age") if name in self._places]
        return tuple(k for place in lasting for k in range(place.start, place.stop))

    @cached_property
    def _change_step(self) -> int:
        return round((self.change_at or 0.0) / self.dt)

    def constants(self, state: Tensor) -> Physics:
        """The constants of the bicycles in ``state`` ``[*batch, k]``: numbers where all have the
        same, else tensors ``[*batch]``."""
        if not self.lasting:
            return self.physics
        return self._own_physics(unstacked(state))

    def _own_physics(self, rows: Sequence[Tensor]) -> Physics:
        own = self._own(TORCH)(rows, self._rows.constants)
        return replace(self.physics, **{name: getattr(own, name) for name in Numbers._fields})

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
            disturbance_dim=self._disturbance_dim,
            reset_dim=self._reset_dim,
            clip_action=self.clip_action,
            headline="angle_to_goal",
            measures=(
                GOAL_RATE,
                GOAL_TIME,
                Measure(
                    "goal_time_over_shortest", "time over the shortest possible", "", "lower", True
                ),
                PATH_LENGTH,
                Measure("shortest_time_s", "shortest possible time", "s", successes=True),
            ),
            words=WORDS,
            survival=True,
            shortest="shortest_time_s",
        )

    @property
    def _disturbance_dim(self) -> int:
        # Where constants are drawn, always with the wind's numbers: an evaluation without wind then
        # finds the constants among the same numbers.
        return 3 if self._gusts is not None or self.spread > 0 else 1

    @property
    def _reset_dim(self) -> int:
        drawn = len(DRAWN) if self.spread > 0 else 0
        return 1 + drawn + (2 if self._is_off_balance else 0)

    @property
    def _is_off_balance(self) -> bool:
        return self.start_lean > 0 or self.start_handlebar > 0

    def _own(self, xp: Namespace) -> Function:
        """The constants of a bicycle over rows, from (state, constants)."""
        changes, drawn = (name in self._places for name in ("age", "factors"))
        first, last = len(STATE), len(STATE) + len(DRAWN)
        clock = first + len(self.lasting) - 1
        changed, times = changed_over(xp), xp.jit(multiplied)

        @xp.jit
        def own(state, c):
            physics = c
            if changes:
                physics = changed(state[clock], c)
            if drawn:
                physics = times(physics, state[first:last])
            return physics

        return own

    def _aim(self, xp: Namespace) -> Function:
        """Where the rider steers for over rows, from (state, constants)."""
        return xp.jit(lambda state, c: GOAL)

    def _upright(self, xp: Namespace) -> Function:
        """Whether the bicycle has not fallen over rows, from (state, constants)."""

        @xp.jit
        def upright(state, c):
            # The sum is finite only if every component is; a comparison with NaN is false.
            total = state[0]
            for k in range(1, len(state)):
                total = total + state[k]
            return xp.both(xp.abs(state[2]) <= c.omega_max, xp.isfinite(total))

        return upright

    def _constants(self) -> tuple[Any, ...]:
        """Of ``rows``."""
        numbers = {name: getattr(self.physics, name) for name in Numbers._fields}
        gusts = self._gusts
        gust = (self.gust, gusts.steps, gusts.chance) if gusts is not None else (0.0,) * 3
        given = (
            *numbers.values(),
            *(numbers | dict(self.change)).values(),
            *(self.dt, self.noise, self.goal_radius, self.start_heading_low),
            *(self.start_heading_high, self.start_lean, self.start_handlebar, self.spread),
            *(self._change_step, *gust),
        )
        return Constants(*(x if isinstance(x, Tensor) else float(x) for x in given))

    def rows(self, xp: Namespace) -> Rows:
        """The functions over rows; NoRows for an integrator that is not."""
        windy, places = self._gusts is not None, self._places
        move = step_over(xp, self.integrate, self.physics.true_precession, windy)
        own, upright = self._own(xp), self._upright(xp)
        aim, angle_to = self._aim(xp), angle_to_over(xp)
        factors, blow = factors_over(xp), gusts_over(xp)
        # Options, and where things are: numba leaves out what is not true of a world.
        drawn, changes, off_balance = "factors" in places, "age" in places, self._is_off_balance
        first, last = len(STATE), len(STATE) + len(self.lasting)
        clock, gust, end = last - 1, last, 1 + len(DRAWN)
        calm, accelerations = (0.0, 0.0), self.lean_acceleration
        lean, bar, l = self._reset_dim - 2, self._reset_dim - 1, DRAWN.index("l")  # noqa: E741

        def step(state, action, uniforms, c):
            displacement = action[1] + (uniforms[0] * (2 * c.noise) - c.noise)
            memory, force = state[first:last], 0.0
            if changes:
                age = (state[clock] + 1,)
                memory = state[first:clock] + age
            if windy:
                blown = blow(
                    *(state[gust], state[gust + 1], uniforms[1], uniforms[2]),
                    *(c.gust, c.gust_steps, c.gust_chance),
                )
                memory, force = memory + blown, blown[0]
            moved = move(state, action[0], displacement, force, own(state, c), c.dt)
            return (*moved, *memory)

        @xp.jit
        def placed(lasting, uniforms, c):
            theta, omega, length = 0.0, 0.0, c.l
            if off_balance:
                omega = c.start_lean * (2 * uniforms[lean] - 1)
                theta = c.start_handlebar * (2 * uniforms[bar] - 1)
            if drawn:
                length = length * lasting[l]
            if windy:
                lasting = lasting + calm
            psi = c.heading_low + (c.heading_high - c.heading_low) * uniforms[0]
            east, north = -xp.sin(psi) * length, xp.cos(psi) * length
            return (theta, 0.0, omega, 0.0, 0.0, psi, east, north, 0.0, 0.0, *lasting)

        def birth(uniforms, c):
            lasting = ()
            if drawn:
                lasting = factors(uniforms[1:end], c.spread)
            if changes:
                lasting = lasting + calm[:1]
            return placed(lasting, uniforms, c)

        def observe(state, c):
            x, y = aim(state, c)
            seen = state[2], state[3], state[0], state[1], angle_to(state, x, y)
            if accelerations:
                return (*seen, state[4])
            return seen

        def outcome(state, c):
            east, north = state[6] - GOAL[0], state[7] - GOAL[1]
            arrived = east * east + north * north <= c.goal_radius * c.goal_radius
            return xp.where(upright(state, c), xp.where(arrived, _SUCCEEDED, _RUNNING), _FAILED)

        return Rows(
            constants=self._constants(),
            width=self.width,
            step=step,
            observe=observe,
            outcome=outcome,
            start=lambda state, uniforms, c: placed(state[first:last], uniforms, c),
            birth=birth,
        )

    def upright(self, state: Tensor) -> Tensor:
        """Whether the bicycle has not fallen, bool ``[*batch]``."""
        return self._upright(TORCH)(unstacked(state), self._rows.constants)

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished rides, each ``[*batch]``; seconds ``[*batch]``.

        goal_rate: 1 if the ride ended at the goal, else 0.  goal_time_s: how long it took, NaN if
        it did not end there.  shortest_time_s: about the least time that the way from ``start`` can
        take (``sims.bicycle.optimum``).  goal_time_over_shortest: goal_time_s over that.
        path_length_m: the length of the path of the tyres, each of which goes v dt in every step,
        whatever the rider does.
        """
        succeeded = self.outcome(final) == int(Outcome.SUCCEEDED)
        # With the constants at the start: nearly all of the turning is done there.
        shortest = shortest_length(
            start,
            goal=GOAL,
            goal_radius=self.goal_radius,
            physics=self.constants(start),
            handlebar=None if self.lasting else self._steady_handlebar,
        )
        shortest_time = self._riding_time(start, shortest)
        goal_time = torch.where(succeeded, seconds, math.nan)
        return {
            "goal_rate": succeeded.to(seconds.dtype),
            "goal_time_s": goal_time,
            "goal_time_over_shortest": goal_time / shortest_time,
            "path_length_m": self.path_length(start, seconds),
            "shortest_time_s": shortest_time,
        }

    def path_length(self, start: Tensor, seconds: Tensor) -> Tensor:
        """Metres ``[*batch]`` that each tyre goes in ``seconds`` ``[*batch]`` from ``start``."""
        first, early, later = self._speeds(start)
        if early is None:
            return seconds * first
        early = torch.minimum(early, seconds)
        return early * first + (seconds - early) * later

    def _riding_time(self, start: Tensor, metres: Tensor) -> Tensor:
        """``path_length`` the other way round: seconds ``[*batch]`` for ``metres``."""
        first, early, later = self._speeds(start)
        if early is None:
            return metres / first
        early = torch.minimum(early, metres / first)
        return early + (metres - early * first) / later

    def _speeds(self, start: Tensor) -> tuple[Scalar, Tensor | None, Scalar]:
        """Speed (m/s) before the change, seconds until it from ``start`` on, speed after it; None
        without a change."""
        if "age" not in self._places:
            speed = self.constants(start).v
            return speed, None, speed
        rows, place = list(unstacked(start)), self._places["age"].start
        age = rows[place]
        speeds = []
        for other in (-math.inf, math.inf):
            rows[place] = torch.full_like(age, other)
            speeds.append(self._own_physics(rows).v)
        return speeds[0], ((self._change_step - age) * self.dt).clamp(min=0.0), speeds[1]

    def baselines(self) -> Mapping[str, Callable[[Tensor], Tensor]]:
        """``lqr``: the regulator that knows the bicycle (``sims.bicycle.lqr``)."""
        from sims.bicycle.lqr import BicycleLqr

        return {"lqr": BicycleLqr(self)}

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[270, 480, 3]``): the path from above and the rider from behind, for
        the states ``[T, k]`` of one ride so far."""
        # Pictures need Pillow, riding does not.
        from sims.bicycle.picture import frame

        return frame(trail, goal=GOAL, goal_radius=self.goal_radius, **self._hanging(trail))

    def _hanging(self, trail: Tensor) -> dict[str, Any]:
        """What a picture must know to say where the rider hangs: the constants, as numbers, and the
        wind in each step of ``trail``."""
        last = self.constants(trail[-1])
        given = {f.name: getattr(last, f.name) for f in fields(last)}
        numbers: Any = {k: float(v) for k, v in given.items() if isinstance(v, Tensor)}
        wind = trail[:, self._places["gust"]][:, 0] if self._gusts is not None else None
        return {"physics": replace(last, **numbers), "dt": self.dt, "side_force": wind}


def _expect(name: str, value: float, expected: str, holds: Callable[[float], bool]) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and holds(value)):
        raise ValueError(f"{name}={value!r}: expected {expected}")
