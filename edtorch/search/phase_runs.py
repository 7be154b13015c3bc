"""Imagined runs of policies of one vector, each until it ends: how far, and how often something was
struck."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edtorch.policy.vector import VectorPolicy
from edtorch.search.ground import NO_GROUND, GroundForce
from edtorch.search.imagination import Futures
from edtorch.search.striking import StrikingModel
from edtorch.search.striking_program import run_kernel
from edtorch.search.tick_model import real, whole


@dataclass(frozen=True, eq=False)
class RunEnds:
    """When a run ends: always, landed ``[R, A]``, rows of the lift that must stay above zero, all
    the time and just after a strike; a force of the ground that would have to pull, or whose
    forward part exceeds ``friction`` times the upward one."""

    always: np.ndarray
    landed: np.ndarray
    ground: GroundForce = NO_GROUND
    friction: float = np.inf


@dataclass(frozen=True, eq=False)
class PhaseRuns:
    """ticks, strikes ``[C, P]``: made before the end."""

    ticks: np.ndarray
    strikes: np.ndarray

    def shares(self, length: np.ndarray, cadence: float) -> np.ndarray:
        """``[C, P]``: of its ``length`` ``[P]``, the ticks that a run made, or its strikes of
        ``cadence`` a tick if that is less; the strike after the last one counts as made."""
        return np.minimum(self.ticks, (self.strikes + 1) / cadence) / length


def phase_runs(
    model: StrikingModel,
    policy: VectorPolicy,
    vectors: np.ndarray,
    futures: Futures,
    push: np.ndarray,
    ends: RunEnds,
) -> PhaseRuns:
    """Of policies ``[C, p]`` in P futures, with ``push`` ``[P, H, m]`` added to their actions.  A
    run is as long as its row of ``push`` is not nan.  All scaled.

    Raises Unavailable where the kernels cannot be compiled.
    """
    shape = (len(vectors), len(futures.start))
    ticks, strikes = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    parts, strike = model.parts
    given = (
        *(real(ends.always), real(ends.landed), real(ends.ground.weight)),
        *(whole(ends.ground.hinge, np.int64), float(ends.friction)),
    )
    form = tuple(map(real, policy.arrays))
    run_kernel(policy.kernel, tuple(part.ndim for part in form))(
        *(real(futures.start), real(push), real(futures.noise), real(vectors)),
        real(futures.weight),
        *(parts, strike, model.free.bounds, form, given),
        *(ticks, strikes),
    )
    return PhaseRuns(ticks, strikes)
