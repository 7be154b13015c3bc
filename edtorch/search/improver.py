"""What improves policies on a learned model: what it is given, and what it leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from edtorch.policy.bounded import BoundedPolicy
from edtorch.search.plan import Cost
from edtorch.search.tick_model import TickModel
from edtorch.types import Parameters

GROWTH = (0.25, 0.5, 0.75, 1.0)
"""Shares of the horizon, one after the other: what a policy does later depends on what it does
first, and the cost over a long horizon has many poor local optima; over a very short one greedy
policies are best."""


@dataclass(frozen=True, eq=False)
class PolicyTask:
    """A policy to improve on a model.

    cov ``[L, K, K]``: of the weights of the model; cost: over so many ticks, at most ``ticks``;
    starts ``[S, n]``: to roll out from; seen ``[k, n]``: all that were seen; reading ``[n]``:
    deviations of the errors of readings; period ``[n]``: of angles, else 0.
    """

    model: TickModel
    cov: Tensor
    policy: BoundedPolicy
    cost: Callable[[int], Cost]
    ticks: int
    starts: Tensor
    seen: Tensor
    reading: Tensor
    period: Tensor

    @property
    def growing(self) -> list[int]:
        """Ticks of the horizons, one after the other."""
        return [max(1, round(share * self.ticks)) for share in GROWTH]


@dataclass(frozen=True, eq=False)
class Improved:
    """Policies ``[C, ...]`` and their costs ``[C]``, inf where one is not finite."""

    parameters: Parameters
    cost: np.ndarray

    @property
    def finite(self) -> Improved:
        """Those with a finite cost."""
        kept = np.isfinite(self.cost)
        rows = torch.from_numpy(kept)
        return Improved({name: p[rows] for name, p in self.parameters.items()}, self.cost[kept])


class Improver(Protocol):
    """A method that lowers a cost, from several policies at once."""

    def check(self, policy: BoundedPolicy) -> None:
        """ValueError for a policy that it cannot improve."""
        ...

    def improve(self, task: PolicyTask, fresh: Parameters, warm: Parameters) -> Improved:
        """Those that began from ``fresh`` ``[R, ...]``, over a growing horizon, then those from
        ``warm`` ``[W, ...]``, which were good over all of it."""
        ...


def side_by_side(*parts: Parameters) -> Parameters:
    """``[R, ...]`` and ``[W, ...]`` as ``[R + W, ...]``."""
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
