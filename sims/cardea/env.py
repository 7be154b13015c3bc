"""Cardea among Gymnasium's environments: ``edtorch/Cardea-v0``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sims.base import spec_index
from sims.cardea.arm import HIGH, LOW
from sims.cardea.cardea import Cardea
from sims.gymnasium_env import Array, SimEnv


class CardeaEnv(SimEnv):
    """Bring a robot's arm to a pose that changes from episode to episode, and hold it there.

    The second experiment of M. Martin, "The Essential Dynamics Algorithm" (2003): an arm of five
    joints on a Segway, whose controller balances and is not ours to command, so that every movement
    of the arm rocks its base.  Robot, sources and constants: ``sims/cardea.urdf``.

    ## Observation Space

    ``Box(19,)``, float64; the goal within the ranges that it is drawn from (``sims.cardea.arm``),
    the rest without bounds: a joint that passes its stop ends the episode there.

    | No. | Observation | Unit |
    |-----|-------------|------|
    | 0-4 | angles: shoulder yaw, shoulder pitch, elbow, wrist pitch, wrist roll | rad |
    | 5 | tilt of the body, positive forward | rad |
    | 6 | position of the base, forward | m |
    | 7-11 | rates of the joints | rad/s |
    | 12 | rate of the tilt | rad/s |
    | 13 | speed of the base | m/s |
    | 14-18 | the goal: wanted angles of the joints | rad |

    ## Action Space

    ``Box(5,)``, float64: torques on the joints, N m, clipped to +-(40, 40, 20, 3, 1.5), then noise
    of 2 % of these limits (standard deviation), then clipped again.

    ## Rewards

    *r = -dt |q - g|^2*, of the state a step arrives at: the paper's shaping reward, a cost per
    second.  ``crash_penalty`` (default 0) is taken off in the step that ends in a crash.  Without
    it a crash ends all further cost, so that agents that maximise the sum over an episode want a
    penalty or a reward of their own.

    ## Starting State

    The base upright and still, the joints at rest anywhere within their ranges; the goal a wrist
    position with a level hand; both 3 cm clear of everything.  ``start`` and ``goal`` fix them.

    ## Episode End

    Termination: the arm touches the robot, a joint passes its stop, or the body tilts by more than
    0.5 rad (info ``outcome`` FAILED).  Truncation: after 2 s, that is 100 steps, as SUCCEEDED if
    the mean error of the joints is below 0.1 rad and their mean speed below 0.2 rad/s, else
    TIMED_OUT.

    ## Arguments

    ``crash_penalty``, ``render_mode`` (None, "rgb_array"), and all those of ``sims.cardea.Cardea``
    by name.

    ## Version History

    * v0: first version.
    """

    def __init__(
        self, *, crash_penalty: float = 0.0, render_mode: str | None = None, **cardea: Any
    ) -> None:
        """The robot, with the arguments ``cardea`` of ``sims.cardea.Cardea``."""
        if not (math.isfinite(crash_penalty) and crash_penalty >= 0):
            raise ValueError(
                f"crash_penalty={crash_penalty!r}: expected a finite number, 0 or more"
            )
        sim = Cardea(**cardea)
        joints, goal = (spec_index(sim.spec, names) for names in (sim.spec.tracked, sim.spec.goal))
        super().__init__(
            sim,
            _ReachingCost(joints, goal, sim.dt),
            fail_penalty=crash_penalty,
            render_mode=render_mode,
            bounds=dict(zip(sim.spec.goal, zip(LOW, HIGH, strict=True), strict=True)),
        )


@dataclass(frozen=True)
class _ReachingCost:
    """The reward of a step of ``dt`` seconds; joints, goal: where they are in the observation."""

    joints: list[int]
    goal: list[int]
    dt: float

    def __call__(self, before: Array, action: Array, after: Array) -> float:
        return -float(np.square(after[self.joints] - after[self.goal]).sum()) * self.dt
