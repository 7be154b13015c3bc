"""No bound is exceeded on random systems: 66 of them, ten steps, by coupled Monte Carlo."""

from __future__ import annotations

import pytest
import torch

from edtorch.bounds import (
    GAUSSIAN,
    UNIFORM,
    NoiseLaw,
    StartLaw,
    bound_errors,
    definition_weights,
)
from edtorch.types import Belief
from tests.bounds.coupled import Draw, coupled, gaussian, one_step, uniform
from tests.bounds.systems import smooth_system
from tests.systems import random_cost

HORIZON = 10


@pytest.mark.oracle
@pytest.mark.parametrize("n, count", [(1, 100_000), (2, 50_000), (5, 25_000)])
@pytest.mark.parametrize("draw, law", [(gaussian, GAUSSIAN), (uniform, UNIFORM)])
def test_no_bound_is_exceeded(n: int, count: int, draw: Draw, law: NoiseLaw) -> None:
    violations = []
    weights = definition_weights(0.95, HORIZON)
    for index in range(11):
        seed = index + (100 if law is UNIFORM else 0)
        # The last three start from a Gaussian; every other system is strongly driven.
        system = smooth_system(n, seed, v0=0.2 if index % 2 else 0.02)
        start, started = None, StartLaw.point()
        if index >= 8:
            cov = 0.05 * random_cost(torch.Generator().manual_seed(seed), n)
            start, started = Belief(system.start, cov), StartLaw.gaussian(cov)
        path, constants = system.path(HORIZON, start), system.constants()
        bounds = bound_errors(path, constants, noise_law=law, weights=weights, start=started)
        steps, value = coupled(system, path, draw, count, weights, seed)
        assert bounds.standing == "certified"
        for t, step in enumerate(steps):
            T1, T2, T3 = one_step(path, t, step, constants)
            following = steps[t + 1] if t < HORIZON else None
            checks = {
                "T1": following is not None and following.mean.exceeds(T1),
                "T2": following is not None and following.cov.exceeds(T2),
                "T3": step.reward.exceeds(T3),
                "mean": step.mean.exceeds(bounds.mean[t]),
                "cov": step.cov.exceeds(bounds.cov[t]),
                "reward": step.reward.exceeds(bounds.reward[t]),
                "second_moment": step.second_moment.exceeds(bounds.second_moment[t]),
                "fourth_moment": step.fourth_moment.exceeds(bounds.fourth_moment[t]),
            }
            violations += [(seed, t, name) for name, broken in checks.items() if broken]
        violations += [(seed, "value")] * value.exceeds(bounds.value)
    assert violations == []
