"""A slalom for the bicycle: gates one after the other instead of one goal."""

from __future__ import annotations

import math
from collections import namedtuple
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from sims.base import Measure, Outcome, Spec
from sims.bicycle.bicycle import GOAL_RATE, GOAL_TIME, PATH_LENGTH, Bicycle, Constants
from sims.rows import TORCH, FallibleRowSim, Function, Namespace, Rows

_GOAL_RADIUS = Bicycle.goal_radius
_COURSE = 3
"""Components that a full state has for the course."""
_RUNNING, _FAILED, _SUCCEEDED, _TIMED_OUT = map(int, Outcome)

Course = namedtuple(
    "Course",
    (*Constants._fields, "gates", "gate_width", "gate_spacing", "gate_offset", "look_ahead"),
)
"""The constants of ``Slalom.rows``."""


@dataclass(frozen=True)
class Slalom(Bicycle, FallibleRowSim):
    """Ride through gates, alternately on the left and on the right of a straight line.

    The line goes from the start to +x; gate k = 1, 2, ... is across it at x = k ``gate_spacing``,
    its middle ``gate_offset`` to the left of the line for odd k and to the right for even, its
    posts ``gate_width`` apart.  The first time that the front tyre is at or beyond the x of the
    next gate decides, to within a step: between the posts the gate is passed, else it is missed;
    the one after it is next either way.

    All is as in ``sims.bicycle.Bicycle`` (its harder worlds too) but for the following.
    ``angle_to_goal`` is to the middle of the gate that is steered for: the next one, until the
    front tyre is within ``look_ahead`` of its line, where the angle to it begins to run away, and
    from there the one after it, the last one at the end.  It jumps in between; that transition is
    masked (``stepped``).  The start heading is within 0.2 rad of the line.  End: FAILED as ever;
    SUCCEEDED with the last gate if all have been passed; TIMED_OUT with the last gate if not, or
    after ``time_limit``.

    A full state is that of the bicycle, followed by the number of gates reached, of gates passed,
    and whether another one has been steered for since the step before.

    Arguments: those of the bicycle, of which ``goal_radius`` is of no use here; ``gates``: how
    many; ``gate_width``, ``gate_spacing``, ``gate_offset``, ``look_ahead`` in m.
    """

    time_limit: float = 300.0
    start_heading_low: float = -math.pi / 2 - 0.2
    start_heading_high: float = -math.pi / 2 + 0.2
    gates: int = 10
    gate_width: float = 4.0
    gate_spacing: float = 40.0
    gate_offset: float = 5.0
    look_ahead: float = 6.0

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        super().__post_init__()
        if isinstance(self.gates, bool) or not isinstance(self.gates, int) or self.gates < 1:
            raise ValueError(f"gates={self.gates!r}: expected a whole number, 1 or more")
        for name, least in (
            ("gate_width", 0.0),
            ("gate_spacing", 2.0),
            ("gate_offset", -math.inf),
            ("look_ahead", -1.0),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > least):
                above = f" above {least:g}" if least > -math.inf else ""
                raise ValueError(f"{name}={value!r}: expected a finite number{above} (m)")
        if self.goal_radius != _GOAL_RADIUS:
            raise ValueError(
                f"goal_radius={self.goal_radius}: expected {_GOAL_RADIUS}, a course has gates and"
                " no goal; set gate_width"
            )

    @cached_property
    def _spec(self) -> Spec:
        passed = Measure("gates_passed", "gates passed", "", "higher")
        missed = Measure("gates_missed", "gates missed", "", "lower")
        return replace(
            super()._spec,
            name="slalom",
            measures=(
                replace(GOAL_RATE, label="share that passes all gates"),
                replace(GOAL_TIME, label="time through all gates"),
                PATH_LENGTH,
                passed,
                missed,
            ),
            shortest="",
        )

    def _middle(self, xp: Namespace) -> Function:
        """Where (x, y) the middle of the gate after ``gate`` others is, or of the last, over rows:
        from (gate, constants)."""

        @xp.jit
        def middle(gate, c):
            index = xp.minimum(gate, c.gates - 1)
            is_odd = index - 2 * xp.floor(index / 2)
            return c.gate_spacing * (index + 1), c.gate_offset * (1 - 2 * is_odd)

        return middle

    def _before_aim(self, xp: Namespace) -> Function:
        """How many gates lie before the one that is steered for: from (x of the front tyre, gates
        reached, constants)."""
        middle = self._middle(xp)

        @xp.jit
        def before(front, gate, c):
            x, _ = middle(gate, c)
            return gate + xp.as_number(front >= x - c.look_ahead)

        return before

    def _aim(self, xp: Namespace) -> Function:
        middle, before, reached = self._middle(xp), self._before_aim(xp), self.width
        return xp.jit(lambda state, c: middle(before(state[6], state[reached], c), c))

    def rows(self, xp: Namespace) -> Rows:
        """Those of the bicycle, and three rows more for the course."""
        ride, width = super().rows(xp), self.width
        move, start, birth = xp.jit(ride.step), xp.jit(ride.start), xp.jit(ride.birth)
        middle, before, upright = self._middle(xp), self._before_aim(xp), self._upright(xp)

        def step(state, action, uniforms, c):
            moved = move(state, action, uniforms, c)
            old, passed = state[width], state[width + 1]
            x, y = middle(old, c)
            reached = xp.both(moved[6] >= x, old < c.gates)
            between = xp.abs(moved[7] - y) <= c.gate_width / 2
            gate = old + xp.as_number(reached)
            passed = passed + xp.as_number(xp.both(reached, between))
            leapt = before(moved[6], gate, c) != before(state[6], old, c)
            return (*moved, gate, passed, xp.as_number(leapt))

        def outcome(state, c):
            over = xp.where(state[width + 1] > c.gates - 0.5, _SUCCEEDED, _TIMED_OUT)
            running = xp.where(state[width] > c.gates - 0.5, over, _RUNNING)
            return xp.where(upright(state, c), running, _FAILED)

        return replace(
            ride,
            constants=Course(
                *(*ride.constants, float(self.gates), float(self.gate_width)),
                *map(float, (self.gate_spacing, self.gate_offset, self.look_ahead)),
            ),
            width=width + _COURSE,
            step=step,
            outcome=outcome,
            start=lambda state, uniforms, c: (*start(state, uniforms, c), 0.0, 0.0, 0.0),
            birth=lambda uniforms, c: (*birth(uniforms, c), 0.0, 0.0, 0.0),
            # Whether one gate was steered for throughout.
            stepped=lambda state, c: state[width + 2] < 0.5,
        )

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished rides, each ``[*batch]``; seconds ``[*batch]``.

        goal_rate: 1 if all gates were passed, else 0; goal_time_s: how long the ride took, NaN
        unless they were; path_length_m: as for the bicycle; gates_passed, gates_missed: the rest
        was not reached.
        """
        succeeded = self.outcome(final) == int(Outcome.SUCCEEDED)
        gate, passed = final[..., self.width], final[..., self.width + 1]
        return {
            "goal_rate": succeeded.to(seconds.dtype),
            "goal_time_s": torch.where(succeeded, seconds, math.nan),
            "path_length_m": self.path_length(start, seconds),
            "gates_passed": passed,
            "gates_missed": gate - passed,
        }

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[270, 480, 3]``): the path and the gates from above and the rider
        from behind, for the states ``[T, k]`` of one ride so far."""
        from sims.bicycle.picture import frame

        middle, constants = self._middle(TORCH), self._rows.constants
        xs, ys = middle(torch.arange(self.gates, dtype=torch.float64), constants)
        half = self.gate_width / 2
        gates = [
            ((x, y - half), (x, y + half)) for x, y in zip(xs.tolist(), ys.tolist(), strict=True)
        ]
        x, y = middle(trail[-1, self.width].double(), constants)
        return frame(trail, goal=(float(x), float(y)), gates=gates, **self._hanging(trail))
