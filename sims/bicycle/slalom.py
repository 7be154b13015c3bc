"""A slalom for the bicycle: gates one after the other instead of one goal."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from sims.base import Measure, Outcome, Spec
from sims.bicycle.bicycle import GOAL_RATE, GOAL_TIME, PATH_LENGTH, Bicycle, angle_to

_GOAL_RADIUS = Bicycle.goal_radius
_COURSE = 3
"""Components that a full state has for the course."""


@dataclass(frozen=True)
class Slalom(Bicycle):
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

    def _middle(self, gate: Tensor) -> tuple[Tensor, Tensor]:
        """Where the middle of the gate after ``gate`` ``[*batch]`` others is, or of the last."""
        index = gate.clamp(max=self.gates - 1)
        is_odd = index - 2 * (index / 2).floor()
        return self.gate_spacing * (index + 1), self.gate_offset * (1 - 2 * is_odd)

    def _aim(self, components: Tensor) -> Tensor:
        """How many gates lie before the one that is steered for."""
        gate = components[self.width]
        x, _ = self._middle(gate)
        return gate + (components[6] >= x - self.look_ahead)

    def _angle(self, components: Tensor) -> Tensor:
        return angle_to(components, *self._middle(self._aim(components)))

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, k]`` from uniforms ``[*batch, reset_dim]``."""
        return self._before_the_first(super().initial(uniforms))

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        bicycle = super().restart(state[..., : self.width], mask, uniforms)
        return torch.where(mask[..., None], self._before_the_first(bicycle), state)

    def _before_the_first(self, bicycle: Tensor) -> Tensor:
        rows = bicycle.movedim(-1, 0)
        return torch.cat((rows, torch.zeros_like(rows[:_COURSE]))).movedim(0, -1)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``dt`` later; action ``[*batch, 2]`` in N m and m; uniforms ``[*batch,
        disturbance_dim]``."""
        bicycle = super().step(state[..., : self.width], action, uniforms)
        rows, course = bicycle.movedim(-1, 0), state.movedim(-1, 0)[self.width :]
        gate, passed = course[0], course[1]
        x, y = self._middle(gate)
        reached = (rows[6] >= x) & (gate < self.gates)
        between = (rows[7] - y).abs() <= self.gate_width / 2
        gate, passed = gate + reached, passed + (reached & between)
        new = torch.cat((rows, torch.stack((gate, passed, gate))))
        leapt = self._aim(new) != self._aim(state.movedim(-1, 0))
        return torch.cat((new[:-1], leapt.to(gate.dtype)[None])).movedim(0, -1)

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the step to ``state`` was one to learn from, bool ``[*batch]``: one gate was
        steered for throughout."""
        return state[..., self.width + 2] < 0.5

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each ride as int64 ``[*batch]``; a fall is looked for first."""
        gate, passed = state[..., self.width], state[..., self.width + 1]
        all_passed = passed > self.gates - 0.5
        over = torch.where(all_passed, int(Outcome.SUCCEEDED), int(Outcome.TIMED_OUT))
        running = torch.where(gate > self.gates - 0.5, over, int(Outcome.RUNNING))
        return torch.where(self.upright(state), running, int(Outcome.FAILED))

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

        xs, ys = self._middle(torch.arange(self.gates, dtype=torch.float64))
        half = self.gate_width / 2
        gates = [
            ((x, y - half), (x, y + half)) for x, y in zip(xs.tolist(), ys.tolist(), strict=True)
        ]
        x, y = self._middle(trail[-1, self.width].double())
        return frame(trail, goal=(float(x), float(y)), gates=gates, **self._hanging(trail))
