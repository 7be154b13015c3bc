"""Policies of any kind, improved side by side by gradients of their expected costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from edtorch.policy.bounded import BoundedPolicy
from edtorch.search.belief import ExpectedCost, Gaussians, gaussians, points
from edtorch.search.improver import Improved, PolicyTask, side_by_side
from edtorch.transform import Cubature, FirstOrder, MeanOnly, Transform
from edtorch.types import Parameters

BELIEFS: Mapping[str, Transform] = {"first_order": FirstOrder(), "cubature": Cubature()}
"""By name, how a belief is propagated."""


@dataclass(frozen=True)
class Adam:
    """Kingma and Ba's method ("Adam: a method for stochastic optimization", 2015), ``steps`` at
    each horizon; its ``rate`` falls to zero along them.

    belief: None: the cost of roll-outs on the model as it is; else its expectation under beliefs
    (``edtorch.search.belief``) that begin as ``components`` Gaussians.
    """

    belief: Literal["first_order", "cubature"] | None = None
    components: int = 1
    steps: int = 60
    rate: float = 0.05

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        for name in ("components", "steps"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name}={value}: expected an integer >= 1")
        if not self.rate > 0:
            raise ValueError(f"rate={self.rate}: expected a number > 0")
        if self.belief is not None and self.belief not in BELIEFS:
            raise ValueError(f"belief={self.belief}: expected null, {', '.join(BELIEFS)}")

    def check(self, policy: BoundedPolicy) -> None:
        """See ``Improver``: any will do."""

    def improve(self, task: PolicyTask, fresh: Parameters, warm: Parameters) -> Improved:
        """See ``Improver``."""
        transform: Transform = MeanOnly() if self.belief is None else BELIEFS[self.belief]
        starts = self._starts(task)
        parameters = fresh
        *first, last = [
            ExpectedCost(
                task.model,
                task.policy,
                task.cost(ticks),
                transform,
                starts,
                task.cov,
                task.reading,
            )
            for ticks in task.growing
        ]
        for cost in first:
            parameters = adam(cost, parameters, self.steps, self.rate).parameters
        return adam(last, side_by_side(parameters, warm), self.steps, self.rate)

    def _starts(self, task: PolicyTask) -> Gaussians:
        if self.belief is None:
            return points(task.starts)
        return gaussians(task.seen, task.period, self.components)


def adam(
    cost: Callable[[Parameters], Tensor], parameters: Parameters, steps: int, rate: float
) -> Improved:
    """The best of the first and of each of ``steps`` steps of every one of B policies, whose costs
    ``[B]`` do not depend on each other; rows that are not finite stay as they are."""
    own = {name: p.clone().requires_grad_() for name, p in parameters.items()}
    optimiser = torch.optim.Adam(own.values(), lr=rate)
    best = {name: p.clone() for name, p in parameters.items()}
    least = torch.full_like(next(iter(own.values())).detach().flatten(1)[:, 0], torch.inf)
    for step in range(steps + 1):
        value = cost(own)
        with torch.no_grad():
            better = value < least
            least = torch.where(better, value, least)
            for name, p in own.items():
                best[name][better] = p[better]
        if step == steps:
            break
        optimiser.zero_grad()
        value[value.isfinite()].sum().backward()
        for p in own.values():
            assert p.grad is not None
            p.grad.nan_to_num_(0.0, 0.0, 0.0)
        for group in optimiser.param_groups:
            group["lr"] = rate * (1 - step / steps)
        optimiser.step()
    return Improved(best, least.numpy())
