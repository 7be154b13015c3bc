"""The choice among plans: each is simulated many times in models drawn from the posterior.

Plans of equal cost differ in their robustness to the uncertainty of the model: gains of hundreds
amplify the errors of readings.  Their success rates distinguish them, in roll-outs whose weights
are drawn from the posterior once each, with random starts and errors of readings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from edtorch.model.evidence import Posterior
from edtorch.search.imagination import Futures, Imagined

ROUNDED = 20
"""Successes are compared in steps of 1 / 20: what differs by less is no difference."""


@dataclass(frozen=True)
class PlanChoice:
    """place: of the chosen plan among the candidates; success: share of its futures in which the
    task was done, nan without a criterion; cost: mean over its finite futures."""

    place: int
    success: float
    cost: float


def futures_of(
    posterior: Posterior,
    starts: Tensor,
    noise: Tensor,
    ticks: int,
    count: int,
    inflation: float,
    generator: np.random.Generator,
) -> Futures:
    """``count`` futures: weights from the posterior with deviations times ``inflation``; true
    starts from the readings ``[k, n]``; errors of readings normal with deviations ``[n]``."""
    n = starts.shape[-1]
    normals = torch.from_numpy(generator.standard_normal((count, *posterior.weight.shape)))
    weight = posterior.drawn(normals, inflation)
    which = generator.integers(len(starts), size=count)
    noise_of = noise.numpy() * generator.standard_normal((count, ticks, n))
    return Futures(weight.numpy(), starts[torch.from_numpy(which)].numpy(), noise_of)


def choose(candidates: Sequence[Imagined], judge: Callable[[Tensor], Tensor] | None) -> PlanChoice:
    """The candidate with the most successes, the least mean cost at a tie; without ``judge``, of
    true states ``[P, H + 1, n]``, the least mean cost alone.  A future that is not finite is no
    success, and costs as much as the dearest that is."""
    found = []
    for place, imagined in enumerate(candidates):
        finite = imagined.finite
        dearest = imagined.cost[finite].max(initial=0.0)
        mean = float(np.where(finite, imagined.cost, dearest).mean()) if finite.any() else np.inf
        success = float("nan")
        if judge is not None:
            state = torch.from_numpy(np.where(finite[:, None, None], imagined.state, 0.0))
            success = float((judge(state).numpy() & finite).mean())
        found.append(PlanChoice(place, success, mean))
    return min(found, key=lambda c: (-_rounded(c.success), c.cost, c.place))


def _rounded(success: float) -> float:
    return 0.0 if np.isnan(success) else round(success * ROUNDED) / ROUNDED
