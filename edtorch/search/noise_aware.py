"""Gains of a plan that weigh the noise of the readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edtorch.search.plan import Cost, Plan
from edtorch.search.program import kernels
from edtorch.search.shooting import expand, planning_problem
from edtorch.search.tick_model import TickModel, real

_FLOOR = 1e-12
"""Added to covariances of the state, so that gains have a limit where nothing is uncertain."""


def noise_aware_gains(
    model: TickModel,
    cost: Cost,
    plan: Plan,
    start: np.ndarray,
    noise: np.ndarray,
    process: np.ndarray | None = None,
    damping: float = 1e-3,
    sweeps: int = 4,
) -> Plan:
    """The same trajectory, with the gains that cost least when states are read with noise.

    The covariance of the state, S, is propagated to first order, as in equation 2 of the paper,
    with the noise that the gains feed back; the gains minimise the expected cost given S:

        S' = (A + B K) S (A + B K)' + B K R K' B' + Q,   K = -Quu^-1 Qux S (S + R)^-1,

    where Quu and Qux are those of the cost to go under the gains of later ticks.  Each depends on
    the other: forward and backward, ``sweeps`` times.  start: covariance of the first state;
    noise (R): of a reading; process (Q): of what a tick adds, each ``[n, n]``, scaled; damping:
    added to Quu, as in ``Descent``.  Raises ValueError for arrays that do not fit each other,
    Unavailable where the kernels cannot be compiled.
    """
    n = plan.state.shape[1]
    added = np.zeros((n, n)) if process is None else process
    for name, matrix in (("start", start), ("noise", noise), ("process", added)):
        if matrix.shape != (n, n):
            raise ValueError(f"{name}: shape {matrix.shape}: expected {(n, n)}, a covariance")
    expansion, _ = expand(planning_problem(model, cost), plan)
    gain = real(plan.gain).copy()
    covariance = np.tile(real(start), (len(plan.state), 1, 1))
    kernels()["noise_aware"](
        *(expansion, (float(damping), sweeps, _FLOOR), gain, covariance),
        *(real(noise), real(added)),
    )
    return replace(plan, gain=gain)
