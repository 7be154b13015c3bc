"""A planar biped with point feet and knee stops, to be walked from rest."""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np
from torch import Tensor

from sims.base import Measure, Outcome, Quantity, Spec, Words
from sims.rows import Function, Namespace, Rows, RowSim, first_over
from sims.tasks.episode import is_before, normal_start_over, readings_over
from sims.tasks.events import events_over
from sims.tasks.five_links import (
    SHANK,
    THIGH,
    TORSO,
    accelerations_over,
    foot_over,
    ground_over,
    impact_over,
    knees_over,
)
from sims.tasks.integrate import runge_kutta_over

_RUNNING, _FAILED, _SUCCEEDED, _TIMED_OUT = map(
    int, (Outcome.RUNNING, Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT)
)

LINKS = ("stance_shank", "stance_thigh", "torso", "swing_thigh", "swing_shank")
START = (0.12, 0.05, 0.0, 0.25, 0.65)
"""rad."""
LOW_HIP, SHORT_STEP = 0.5, 0.05
"""m, below which an episode fails."""
HIP_TORQUE = 150.0
"""N m."""

Constants = namedtuple("Constants", ("dt", "time_limit", "friction", "wanted_steps"))
"""The constants of ``Walker.rows``."""

_PLACE, _STEPS, _FALLEN, _TICK, _USED, _FORCE_X, _FORCE_Y = range(10, 17)
"""Where they are in a full state."""


class Walker(RowSim):
    """RABBIT (``sims.tasks.five_links``), a planar biped of 40 kg with point feet: the stance foot
    is a pivot, and no torque acts on it.  The knees do not bend forward beyond straight: inelastic
    stops.  At the strike of the swing foot it becomes the stance foot, and all labels change legs.

    ======== ==================================================================================
    state    leans of the links from upright (rad, positive forward), each followed by its rate
             (rad/s): ``stance_shank``, ``stance_thigh``, ``torso``, ``swing_thigh``,
             ``swing_shank``; with ``foot`` also ``steps``, the number of strikes so far, and the
             force of the ground on the stance foot at the start of the last tick (N, forward and
             up): ``force_x``, ``force_y``
    action   torques (N m): ``stance_knee``, ``swing_knee``, within ``knee_torque``, positive
             bends a knee; ``stance_hip``, ``swing_hip``, within 150, positive leans a thigh forward
             against the torso
    start    at rest on one foot, the other behind and 0.09 m up; normal, standard deviations
             0.02 rad and 0.1 rad/s, a knee beyond its stop moved to it
    stops    shank - thigh >= 0
    end      a fall: the hip below 0.5 m; at the start of a tick a ground that would have to pull,
             or to hold by more than ``friction`` times its upward force; a foot that strikes less
             than 0.05 m ahead of the other.  All motion stops there
    success  ``wanted_steps`` steps before a fall or the time limit ends the episode
    ======== ==================================================================================

    A motor holds its torque for a tick, also where its leg becomes the other one.  A foot that
    strikes does not bounce or slip, and the other one leaves the ground at once; where it would
    have to press on, it strikes again and the episode fails.  Impulses are not held against
    ``friction``.  A knee at its stop that the hit of the other one would open by less than 0.001
    rad/s is held, so that two knees do not hit in turns for ever.

    A full state is the ten leans and rates, followed by the place of the stance foot (m), steps,
    1 after a fall, else 0, the tick, the greatest ratio of forward to upward force so far, and the
    two forces.

    ``knee_torque``: 150 N m suffices to keep the knees off their stops, 25 N m does not.
    """

    substeps, events = 4, 4
    """Of a tick, and how many knee hits and strikes it may have (``sims.tasks.events``)."""

    def __init__(
        self,
        knee_torque: float = 25.0,
        friction: float = 0.8,
        wanted_steps: int = 20,
        foot: bool = True,
        dt: float = 0.01,
        time_limit: float = 30.0,
    ) -> None:
        for name, value in (("knee_torque", knee_torque), ("friction", friction), ("dt", dt)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}={value}: expected a finite number above 0")
        if not dt <= time_limit < math.inf:
            raise ValueError(f"time_limit={time_limit}: expected at least dt={dt} (s)")
        if not (wanted_steps >= 1 and wanted_steps == int(wanted_steps)):
            raise ValueError(f"wanted_steps={wanted_steps}: expected a whole number, 1 or more")
        self.foot = foot
        self.constants = Constants(*map(float, (dt, time_limit, friction, wanted_steps)))
        angles = [Quantity(name, "rad", period=2 * math.pi) for name in LINKS]
        rates = [Quantity(f"{name}_rate", "rad/s", scale=6.0, rate_of=name) for name in LINKS]
        sensed = (
            Quantity("steps", "", low=0.0),
            Quantity("force_x", "N", scale=400.0),
            Quantity("force_y", "N", scale=400.0),
        )
        torques = {
            **{"stance_knee": float(knee_torque), "stance_hip": HIP_TORQUE},
            **{"swing_hip": HIP_TORQUE, "swing_knee": float(knee_torque)},
        }
        self.spec = Spec(
            name="walker",
            state=(
                *(q for pair in zip(angles, rates, strict=True) for q in pair),
                *(sensed if foot else ()),
            ),
            action=tuple(
                Quantity(name, "N m", scale=bound, low=-bound, high=bound)
                for name, bound in torques.items()
            ),
            dt=dt,
            time_limit=time_limit,
            disturbance_dim=0,
            reset_dim=10,
            clip_action=True,
            headline="torso",
            measures=(
                Measure("steps", "steps", better="higher", median="steps_median"),
                Measure("distance_m", "distance that the hip went forward", "m", "higher"),
                Measure("friction_used", "greatest ratio of forward to upward force", "", "lower"),
            ),
            words=Words("fall", "falls", "walk", "walks", "fell", "walked"),
            survival=False,
            can_fail=True,
        )

    def rows(self, xp: Namespace) -> Rows:
        """A look at the ground's force, then motion through knee hits and strikes."""
        body, kept, before = first_over(xp, 10), first_over(xp, 13), xp.jit(is_before)
        move, accelerations, knees = _motion_over(xp), accelerations_over(xp), knees_over(xp)
        ground, split = ground_over(xp), _split_over(xp)
        hip = xp.jit(lambda s: SHANK * xp.cos(s[0]) + THIGH * xp.cos(s[2]))
        passed = events_over(
            xp,
            move,
            _gaps_over(xp),
            _land_over(xp),
            width=17,
            guards=3,
            substeps=self.substeps,
            events=self.events,
        )
        mean = tuple(x for lean in START for x in (lean, 0.0))
        drawn = normal_start_over(xp, mean, (0.02, 0.1) * 5)

        def step(s, action, uniforms, c):
            q, v = split(s)
            x, y = ground(q, v, accelerations(q, v, action, knees(q, v)))
            holds = xp.both(y >= 0.0, xp.abs(x) <= c.friction * y)
            stands = xp.both(xp.both(s[_FALLEN] < 0.5, hip(s) >= LOW_HIP), holds)
            fell = xp.where(stands, 0.0, 1.0)
            ratio = xp.where(stands, xp.abs(x) / xp.where(y > 0.0, y, 1.0), 0.0)
            moved = passed(
                (*body(s), s[_PLACE], s[_STEPS], fell, action[0], action[1], action[2], action[3]),
                c.dt,
            )
            return (*kept(moved), s[_TICK] + 1, xp.maximum(s[_USED], ratio), x, y)

        def outcome(s, c):
            up = xp.both(s[_FALLEN] < 0.5, hip(s) >= LOW_HIP)
            walked = s[_STEPS] > c.wanted_steps - 0.5
            ended = xp.where(up, xp.where(walked, _SUCCEEDED, _TIMED_OUT), _FAILED)
            ended = xp.where(walked, _SUCCEEDED, ended)
            running = xp.both(up, before(s[_TICK], c.time_limit, c.dt))
            return xp.where(running, _RUNNING, ended)

        def start(s, u, c):
            a0, b0, a1, b1, a2, b2, a3, b3, a4, b4 = drawn(s, u, c)
            return (
                *(xp.maximum(a0, a1), b0, a1, b1, a2, b2, a3, b3, xp.maximum(a4, a3), b4),
                *(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            )

        seen = readings_over(xp, self.spec.state[:10])

        def readings(s, c):
            return (*seen(s, c), s[_STEPS], s[_FORCE_X], s[_FORCE_Y])

        return Rows(
            width=17,
            step=step,
            observe=readings if self.foot else seen,
            outcome=outcome,
            start=start,
            constants=self.constants,
        )

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished episodes, each ``[*batch]``.

        steps: strikes of a foot; distance_m: of the hip from where it was, forward; friction_used:
        the greatest ratio of the ground's forward to its upward force, either way, at the starts of
        the ticks that it held.
        """

        def hip(state: Tensor) -> Tensor:
            return state[..., _PLACE] + SHANK * state[..., 0].sin() + THIGH * state[..., 2].sin()

        return {
            "steps": final[..., _STEPS],
            "distance_m": hip(final) - hip(start),
            "friction_used": final[..., _USED],
        }

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[270, 480, 3]``) of the links and the path of the hip, for the
        states ``[T, k]`` of one episode so far."""
        from sims.tasks.picture import walk

        states = trail.detach().double()
        q, foot = states[:, 0:10:2].numpy(), states[:, _PLACE].numpy()

        def along(from_: np.ndarray, length: float, lean: np.ndarray) -> np.ndarray:
            return from_ + length * np.stack([np.sin(lean), np.cos(lean)], -1)

        stance = np.stack([foot, np.zeros_like(foot)], -1)
        knee = along(stance, SHANK, q[:, 0])
        hip = along(knee, THIGH, q[:, 1])
        bent = along(hip, -THIGH, q[:, 3])
        torso, swing = along(hip, TORSO, q[:, 2]), along(bent, -SHANK, q[:, 4])
        legs = [np.stack(p)[:, -1] for p in ((stance, knee, hip), (hip, bent, swing))]
        # A leg keeps its colour.
        if int(states[-1, _STEPS]) % 2:
            legs.reverse()
        return walk(
            [*legs, np.stack([hip[-1], torso[-1]])],
            path=hip,
            seconds=float(states[-1, _TICK]) * self.constants.dt,
        )


def _split_over(xp: Namespace) -> Function:
    """Leans and rates of a state."""
    return xp.jit(lambda s: ((s[0], s[2], s[4], s[6], s[8]), (s[1], s[3], s[5], s[7], s[9])))


def _motion_over(xp: Namespace) -> Function:
    """Of the rows within a tick: leans and rates, place of the foot, steps, fallen, four torques.
    A step of Runge and Kutta's method with the knees that are at their stops; none after a fall."""
    accelerations, knees, split = accelerations_over(xp), knees_over(xp), _split_over(xp)
    body = first_over(xp, 10)

    @xp.jit
    def derivative(s, given):
        torques, stops = given
        q, v = split(s)
        a0, a1, a2, a3, a4 = accelerations(q, v, torques, stops)
        return v[0], a0, v[1], a1, v[2], a2, v[3], a3, v[4], a4

    integrated = runge_kutta_over(xp, derivative, 10, 1)

    @xp.jit
    def move(s, seconds):
        q, v = split(s)
        given = ((s[13], s[14], s[15], s[16]), knees(q, v))
        return (
            *integrated(body(s), given, xp.where(s[12] > 0.5, 0.0, seconds)),
            *(s[10], s[11], s[12], s[13], s[14], s[15], s[16]),
        )

    return move


def _gaps_over(xp: Namespace) -> Function:
    """Angles of the two knees and height of the swing foot, each with its rate; of a knee at its
    stop, and after a fall, no event: 1 and 0."""
    foot, knees, split = foot_over(xp), knees_over(xp), _split_over(xp)

    @xp.jit
    def gaps(s):
        q, v = split(s)
        stance, swing = knees(q, v)
        _, height, _, rise = foot(q, v)
        fell = s[12]
        off_1, off_2 = xp.maximum(stance, fell) > 0.5, xp.maximum(swing, fell) > 0.5
        return (
            *(xp.where(off_1, 1.0, q[0] - q[1]), xp.where(off_1, 0.0, v[0] - v[1])),
            *(xp.where(off_2, 1.0, q[4] - q[3]), xp.where(off_2, 0.0, v[4] - v[3])),
            *(xp.where(fell > 0.5, 1.0, height), xp.where(fell > 0.5, 0.0, rise)),
        )

    return gaps


def _land_over(xp: Namespace) -> Function:
    """The state after the event of a guard: 0 and 1, the knees of stance and swing leg, 2, the
    strike of the swing foot; -1 where there is none."""
    foot, knees, split = foot_over(xp), knees_over(xp), _split_over(xp)
    impact = impact_over(xp)

    @xp.jit
    def land(s, guard):
        event, strikes = guard > -0.5, guard > 1.5
        q, v = split(s)
        stance, swing = knees(q, v)
        hit_1 = xp.both(event, guard < 0.5)
        hit_2 = xp.both(event, xp.both(guard > 0.5, guard < 1.5))
        stance, swing = xp.where(hit_1, 1.0, stance), xp.where(hit_2, 1.0, swing)
        ahead, _, east, up = foot(q, v)
        # A shank is moved to its stop, from which it is as far as a guard's root is rough.
        q0, q4 = xp.where(hit_1, q[1], q[0]), xp.where(hit_2, q[3], q[4])
        p = (
            xp.where(strikes, q4, q0),
            xp.where(strikes, q[3], q[1]),
            q[2],
            xp.where(strikes, q[1], q[3]),
            xp.where(strikes, q0, q4),
        )
        w = (
            xp.where(strikes, v[4], v[0]),
            xp.where(strikes, v[3], v[1]),
            v[2],
            xp.where(strikes, v[1], v[3]),
            xp.where(strikes, v[0], v[4]),
        )
        stops = (xp.where(strikes, swing, stance), xp.where(strikes, stance, swing))
        east, up = xp.where(strikes, east, 0.0), xp.where(strikes, up, 0.0)
        n0, n1, n2, n3, n4 = impact(p, w, east, up, stops)
        # What an impulse has stopped is at rest exactly.
        n0 = xp.where(xp.both(stops[0] > 0.5, xp.abs(n0 - n1) < 1e-9), n1, n0)
        n4 = xp.where(xp.both(stops[1] > 0.5, xp.abs(n4 - n3) < 1e-9), n3, n4)
        short = xp.both(strikes, ahead < SHORT_STEP)
        return (
            *(p[0], xp.where(event, n0, v[0]), p[1], xp.where(event, n1, v[1])),
            *(p[2], xp.where(event, n2, v[2]), p[3], xp.where(event, n3, v[3])),
            *(p[4], xp.where(event, n4, v[4])),
            s[10] + xp.where(strikes, ahead, 0.0),
            s[11] + xp.where(short, 0.0, xp.where(strikes, 1.0, 0.0)),
            xp.where(short, 1.0, s[12]),
            *(xp.where(strikes, s[16], s[13]), xp.where(strikes, s[15], s[14])),
            *(xp.where(strikes, s[14], s[15]), xp.where(strikes, s[13], s[16])),
        )

    return land
