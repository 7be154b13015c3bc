"""Problems with a known answer for rivals with networks."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from edtorch.learner.learner import Actor
from edtorch.rivals.base import Problem, Search
from sims.linear import LinearSystem
from tests.rivals.problems import problem

PULL, COST = 0.8, 0.25
"""s' = PULL s + a, r = -(s'^2 + COST a^2), one step: the best action is -PULL / (1 + COST) s."""
GAIN = PULL / (1 + COST)


def linear_problem(
    seeds: Sequence[int], *, noise: float = 0.0, ticks: int = 1, dt: float = 1.0
) -> Problem:
    """One-dimensional, from starts in [-1, 1]."""
    sim = LinearSystem([[PULL]], [[1.0]], noise=noise, dt=dt, time_limit=ticks * dt)
    return problem(sim, [1.0], [COST], seeds)


STARTS = torch.tensor([[-0.9], [-0.5], [0.0], [0.5], [0.9]], dtype=torch.float64)


def actions(search: Search) -> Tensor:
    """Of each policy at ``STARTS``, ``[S, 5]``."""
    actor: Actor = search.actor
    count = len(search.accounts)
    repeated = {k: p.repeat_interleave(len(STARTS), 0) for k, p in search.parameters.items()}
    return actor.action(repeated, STARTS.repeat(count, 1)).reshape(count, len(STARTS))


def largest_error(search: Search) -> float:
    """Of the actions at ``STARTS``, from the best ones."""
    return float((actions(search) + GAIN * STARTS.T).abs().max())


def carry_on() -> None:
    """A pause in which nothing happens."""
