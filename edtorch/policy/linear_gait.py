"""Policies linear in the readings, to be searched among as those by a phase are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import within
from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.model.told import Told
from edtorch.policy.phase import PhaseGait, PhasePolicy
from edtorch.policy.squash import Squash
from edtorch.policy.vector import VectorPolicy
from edtorch.types import Parameters


@dataclass(frozen=True)
class LinearGait:
    """about: a gait whose gains a search begins with, its curves replaced by straight lines of the
    phase, None for a policy that begins at zero; spread, spread_constant: deviations of random
    gains, per unit of the scaled state, and of constants, both in parts of half the range of an
    action."""

    about: PhaseGait | None = None
    spread: float = 0.5
    spread_constant: float = 0.2

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        for name in ("spread", "spread_constant"):
            value = getattr(self, name)
            if not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0")

    @property
    def words(self) -> str:
        """See ``Gait``."""
        return "a policy that begins at zero" if self.about is None else self.about.words

    def policy(self, told: Told, squash: Squash) -> LinearGaitPolicy:
        """See ``Gait``."""
        return LinearGaitPolicy(self, told, squash)


@final
class LinearGaitPolicy(VectorPolicy):
    """z = K s + b of the k components that are not ignored.

    parameters: ``gain`` K ``[B, m, k]``, ``constant`` b ``[B, m]``.  Raises ValueError for unknown
    names.
    """

    kernel = "linear"

    def __init__(self, gait: LinearGait, told: Told, squash: Squash) -> None:
        super().__init__(squash)
        self.gait = gait
        used = [i for i, name in enumerate(told.names) if name not in told.ignored]
        self.components = torch.tensor(used)
        m = len(told.actions)
        self._first = np.zeros((m, len(used))), np.zeros(m)
        if gait.about is not None:
            with within("about"):
                gain, constant = _straight(gait.about.policy(told, squash))
            self._first = gain[:, used], constant

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """See ``VectorPolicy``."""
        return (self.components.numpy(),)

    @property
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """See ``VectorPolicy``."""
        gain, constant = self._first
        return {"gain": gain.shape, "constant": constant.shape}

    @property
    def begun(self) -> tuple[Tensor, Tensor]:
        """See ``VectorPolicy``."""
        gain, constant = self._first
        sizes = gain.size, constant.size
        spread = np.repeat((self.gait.spread, self.gait.spread_constant), sizes)
        return torch.from_numpy(np.append(gain, constant)), torch.from_numpy(spread)

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """See ``BoundedPolicy``."""
        seen = state.index_select(-1, self.components)
        return matvec(parameters["gain"], seen) + parameters["constant"]

    def raw_law(self, parameters: Arrays) -> Law:
        """See ``BoundedPolicy``."""
        gain, constant = parameters["gain"], parameters["constant"]
        used = self.components.numpy()
        return lambda state: gain @ state[used] + constant


def _straight(policy: PhasePolicy) -> tuple[np.ndarray, np.ndarray]:
    """Gain ``[m, n]`` and constant ``[m]`` of a policy by a phase whose curves are replaced by
    those straight lines that are nearest to them over a step, by least squares, and go on beyond
    it."""
    phase, joint, rate, gain, _, _, drive = policy.arrays
    joints = list(policy.gait.followed.values())
    fed = np.array([each.feedback or 0.0 for each in joints])
    slope, middle = np.array([_line(np.array(each.points)) for each in joints]).T
    start, width = policy.gait.start, policy.gait.width
    target = np.outer(slope / width, phase[0]) + np.outer(fed, phase[1])
    whole = gain[:, :1] * (target - joint) - gain[:, 1:] * rate
    return drive @ whole, drive @ (gain[:, 0] * (middle - slope * (start / width + 0.5)))


def _line(points: np.ndarray) -> tuple[float, float]:
    """Slope, and value in the middle, of the line nearest to a Bezier curve of these points over
    [0, 1]: of its Bernstein polynomials the integral is 1 / (d + 1), the first moment
    (k + 1) / ((d + 1) (d + 2))."""
    count = len(points)
    if count == 1:
        return 0.0, float(points[0])
    mean = float(points.mean())
    moment = float(points @ np.arange(1, count + 1)) / (count * (count + 1))
    return 12 * (moment - mean / 2), mean
