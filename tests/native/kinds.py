"""Learners of many kinds in small worlds, eager and compiled."""

from __future__ import annotations

from typing import Any

import torch
from torch.utils import _pytree as pytree

from edtorch.app.build import build
from edtorch.app.compose import compose
from edtorch.native.plan import plan_of
from edtorch.native.stage import Native
from edtorch.run.training import Training

LINEAR = (
    "domain=linear",
    "domain.state_matrix=[[1.0,0.1],[0.0,1.0]]",
    "domain.action_matrix=[[0.0],[0.5]]",
    "domain.time_limit=30",
    "reward=quadratic",
    "+reward.state.state_0=1.0",
    "train.successes=null",
)
"""Two components, pushed at the second; episodes of 30 ticks."""


def training_of(*overrides: str, stride: int = 1) -> Training:
    """A population of a configuration, uncompiled."""
    setup = build(compose(list(overrides)))
    return Training(setup.learner, setup.world, setup.seeds, setup.budget, stride, setup.schedule)


def native(training: Training, **how: Any) -> Training:
    """The same population, compiled."""
    population = training.stage.population
    plan = plan_of(training.tick, population)
    training.stage = Native(plan, training.tick, population, training.seeds, **how)
    return training


def lives(training: Training) -> list[tuple[Any, ...]]:
    """Every episode, without its figures."""
    return [(e.row, e.number, e.start, e.seconds, e.outcome) for e in training.episodes]


def farthest(found: Training, wanted: Training) -> dict[str, float]:
    """Greatest |difference| / (1 + |wanted|) of each leaf of a population; NaN equals NaN."""
    leaves = pytree.tree_flatten_with_path(wanted.stage.population)[0]
    others = pytree.tree_leaves(found.stage.population)
    worst = {}
    for (path, right), other in zip(leaves, others, strict=True):
        assert other.dtype == right.dtype and other.shape == right.shape
        left, right = other.double(), right.double()
        same = (left == right) | (left.isnan() & right.isnan())
        error = torch.where(same, 0.0, (left - right).abs() / (1 + right.abs()))
        name = ".".join(str(getattr(key, "name", getattr(key, "key", key))) for key in path)
        worst[name] = float(error.nan_to_num(nan=torch.inf).max()) if error.numel() else 0.0
    return worst
