"""What is planned for, and a plan: arrays in scaled units, as a learner sees states and actions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Cost:
    """The cost of a trajectory of H ticks, with A the lift of a state (``edtorch.model.lift``):

        sum_{t=1..H} weight[t] |rows[t] A(s_t)|^2
        + sum_{t<H} action . ((u_t - middle) / half)^2 + squash |z_t|^2

    rows ``[H + 1, r, A]``, whose columns of the action are 0; weight ``[H + 1]``; action ``[m]``;
    squash: keeps the raw actions z_t where the hyperbolic tangent is not flat.
    """

    rows: np.ndarray
    weight: np.ndarray
    action: np.ndarray
    squash: float = 1e-3

    @property
    def ticks(self) -> int:
        """H."""
        return len(self.weight) - 1

    def part(self, first: int, last: int) -> Cost:
        """Of the ticks from ``first`` to ``last``, whose states are both counted in."""
        span = slice(first, last + 1)
        return Cost(self.rows[span], self.weight[span], self.action, self.squash)


@dataclass(frozen=True, eq=False)
class Plan:
    """A trajectory with the gains that hold it: the action at tick t in state s is

        u = middle + half tanh(z_t + K_t wrap(s - s_t)),

    where differences of angles are wrapped.  state ``[H + 1, n]``, raw (z) ``[H, m]``, gain (K)
    ``[H, m, n]``; cost: of the trajectory without noise (``Cost``).
    """

    state: np.ndarray
    raw: np.ndarray
    gain: np.ndarray
    cost: float


def ramp(ticks: int, power: float, until: int | None = None) -> np.ndarray:
    """Weights ``[H + 1]``, (t / until)^power and then 1, ``until`` being H by default: they grow,
    so that a plan may take its time.  With power 0 nearly all starts end in poor local optima of a
    swing-up."""
    return np.minimum(np.arange(ticks + 1) / (until or ticks), 1.0) ** power
