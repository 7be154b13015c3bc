"""Tasks of rods whose tip is to be brought to a point and held there."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import namedtuple
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from sims.base import Measure, Outcome, Quantity, Spec
from sims.rows import TORCH, Function, Namespace, Rows, RowSim, first_over, stacked, unstacked
from sims.tasks.episode import (
    first_tick,
    is_before,
    normal_start_over,
    readings_over,
)
from sims.tasks.integrate import runge_kutta_over

_RUNNING, _SUCCEEDED, _TIMED_OUT = map(int, (Outcome.RUNNING, Outcome.SUCCEEDED, Outcome.TIMED_OUT))

Constants = namedtuple(
    "Constants", ("dt", "time_limit", "hold_from", "width", "height", "amplitude", "period")
)
"""The constants of ``HeldTip.rows``."""

TIP_DISTANCE = Measure("tip_distance_m", "distance of the tip at the end", "m", "lower")
TIP_RMS = Measure("tip_rms_m", "rms distance of the tip while it is to be held", "m", "lower")


class HeldTip(RowSim, ABC):
    """A mechanism of rods in a vertical plane, and a point where the tip of the last is to be.

    Angles are from upright, positive anticlockwise: a rod of length l ends l (-sin, cos) from its
    joint.  The target is (amplitude sin(2 pi t / period), height) t seconds after the start.  An
    episode ends at ``time_limit``, nothing ends it before, and is a success if the tip was within
    ``width`` of the target at every tick from ``hold_from`` on, by the true state.

    A full state is the mechanism's, its angles counted on beyond half a turn, followed by the tick,
    1 as long as an episode may still be a success, else 0, and the sum of the squared distances
    (m^2) since ``hold_from``.  An observation has the angles within half a turn of upright.

    A subclass has the attributes below, ``derivative`` and ``joints``, and a constructor with the
    published values as defaults.

    Arguments: ``width``, ``amplitude`` in m; ``dt``, ``time_limit``, ``hold_from``, ``period`` in
    s.
    """

    name: ClassVar[str]
    """Of the domain."""
    state: ClassVar[tuple[Quantity, ...]]
    """The components of the mechanism's state."""
    action: ClassVar[tuple[Quantity, ...]]
    """The components of the action."""
    mean: ClassVar[tuple[float, ...]]
    """Of the normal distribution of the start, per component."""
    deviation: ClassVar[tuple[float, ...]]
    """Standard deviations of it."""
    height: ClassVar[float]
    """Of the target, m."""
    substeps: ClassVar[int]
    """Of Runge and Kutta's method in a tick."""
    walls: ClassVar[tuple[float, ...]] = ()
    """Angles at which a rod from the first joint is stopped, for the pictures."""

    def __init__(
        self,
        dt: float,
        time_limit: float,
        hold_from: float,
        width: float,
        amplitude: float = 0.0,
        period: float = 1.0,
    ) -> None:
        """Refuse impossible arguments."""
        for key, value in (("dt", dt), ("width", width), ("period", period)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{key}={value}: expected a finite number above 0")
        if not dt <= hold_from <= time_limit < math.inf:
            raise ValueError(
                f"hold_from={hold_from}, time_limit={time_limit}: expected seconds in this order,"
                f" from dt={dt} on"
            )
        if not math.isfinite(amplitude):
            raise ValueError(f"amplitude={amplitude}: expected a finite number (m)")
        self.constants = Constants(
            *map(float, (dt, time_limit, hold_from, width, self.height, amplitude, period))
        )
        self.spec = Spec(
            name=self.name,
            state=self.state,
            action=self.action,
            dt=dt,
            time_limit=time_limit,
            disturbance_dim=0,
            reset_dim=len(self.state),
            clip_action=True,
            headline=next(quantity.name for quantity in self.state if quantity.period),
            measures=(TIP_DISTANCE, TIP_RMS),
            survival=False,
            can_fail=False,
        )

    @abstractmethod
    def derivative(self, xp: Namespace) -> Function:
        """ds/dt of the mechanism: a function of its state and the action, tuples of rows."""

    def motion(self, xp: Namespace) -> Function:
        """The mechanism's state after ``dt`` seconds: a function of (its state, action, dt), steps
        of Runge and Kutta's method."""
        return runge_kutta_over(xp, xp.jit(self.derivative(xp)), len(self.mean), self.substeps)

    @abstractmethod
    def joints(self, xp: Namespace) -> Function:
        """Where joints and tip are: a function of the mechanism's state that gives (x, y, x, y...)
        in m, from the first joint, at height 0, to the tip."""

    def _distance(self, xp: Namespace) -> Function:
        """Of the tip from its target, m: from (mechanism's state, seconds, constants)."""
        joints, reference = xp.jit(self.joints(xp)), _reference_over(xp)

        @xp.jit
        def distance(s, seconds, c):
            places = joints(s)
            east, up = places[-2] - reference(seconds, c), places[-1] - c.height
            return xp.sqrt(east * east + up * up)

        return distance

    def rows(self, xp: Namespace) -> Rows:
        """The motion, and three rows more for the judgement."""
        n = len(self.mean)
        mechanism, distance = first_over(xp, n), self._distance(xp)
        move = self.motion(xp)
        start, before = normal_start_over(xp, self.mean, self.deviation), xp.jit(is_before)

        def step(s, action, uniforms, c):
            moved, tick = move(mechanism(s), action, c.dt), s[n] + 1
            away = distance(moved, tick * c.dt, c)
            early = before(tick, c.hold_from, c.dt)
            held = s[n + 1] * xp.as_number(xp.either(early, away <= c.width))
            return (*moved, tick, held, s[n + 2] + xp.where(early, 0.0, away * away))

        def outcome(s, c):
            ended = xp.where(s[n + 1] > 0.5, _SUCCEEDED, _TIMED_OUT)
            return xp.where(before(s[n], c.time_limit, c.dt), _RUNNING, ended)

        return Rows(
            width=n + 3,
            step=step,
            observe=readings_over(xp, self.spec.state),
            outcome=outcome,
            start=lambda s, u, c: (*start(s, u, c), 0.0, 1.0, 0.0),
            constants=self.constants,
        )

    def target(self, seconds: Tensor) -> Tensor:
        """Where the tip is to be ``seconds`` ``[*batch]`` after the start, ``[*batch, 2]``: m right
        and up."""
        east = _reference_over(TORCH)(seconds, self.constants)
        return torch.stack([east, torch.full_like(east, self.constants.height)], -1)

    def distance(self, states: Tensor, seconds: Tensor | float = 0.0) -> Tensor:
        """How far the tip is from its target ``seconds`` ``[*batch]`` after the start, m
        ``[*batch]``; states ``[*batch, n]`` or longer, in the units of ``spec.state``."""
        rows = unstacked(states)[: len(self.mean)]
        return self._distance(TORCH)(rows, torch.as_tensor(seconds).to(states), self.constants)

    def judge(self, states: Tensor) -> Tensor:
        """Whether episodes with these true states ``[*batch, T + 1, n]``, one per tick from the
        start on, are successes, bool ``[*batch]``; one that ends before ``time_limit`` is none,
        states after it do not count."""
        c, ticks = self.constants, torch.arange(states.shape[-2]).to(states)
        near = self.distance(states, ticks * c.dt) <= c.width
        ended = ~is_before(ticks, c.time_limit, c.dt)
        after = ~is_before(ticks - 1, c.time_limit, c.dt)
        outside = is_before(ticks, c.hold_from, c.dt) | after
        return (near | outside).all(-1) & ended.any()

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished episodes, each ``[*batch]``.

        tip_distance_m: of the tip from its target in the last state; tip_rms_m: root of the mean
        square of that distance over the ticks from ``hold_from`` on, NaN if there were none.
        """
        c, (tick, _, squares) = self.constants, final[..., len(self.mean) :].unbind(-1)
        held = tick - first_tick(c.hold_from, c.dt) + 1
        return {
            "tip_distance_m": self.distance(final, tick * c.dt),
            "tip_rms_m": (squares / held.clamp(min=0)).sqrt(),
        }

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[270, 480, 3]``) of the rods, the path of the tip and its target,
        for the states ``[T, k]`` of one episode so far."""
        from sims.tasks.picture import rods

        trail, n, c = trail.detach().double(), len(self.mean), self.constants
        places = stacked(self.joints(TORCH)(unstacked(trail)[:n]), trail)
        seconds = trail[-1, n] * c.dt
        return rods(
            places.reshape(len(trail), -1, 2).numpy(),
            target=self.target(seconds).numpy(),
            width=c.width,
            on_rail=self.spec.state[0].name == "position",
            seconds=float(seconds),
            walls=self.walls,
        )


def _reference_over(xp: Namespace) -> Function:
    """How far right the target is, m: from (seconds, constants)."""
    return xp.jit(lambda seconds, c: c.amplitude * xp.sin(2 * math.pi * seconds / c.period))
