"""Bounds that hold at every time, for contractions."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from edtorch.bounds import (
    GAUSSIAN,
    Constants,
    NoiseLaw,
    StartLaw,
    definition_weights,
    uniform_bounds,
)
from tests.bounds.coupled import coupled, gaussian
from tests.bounds.systems import RADEMACHER, Law, exact_errors, exact_laws, smooth_system
from tests.systems import f64


def test_they_are_attained_by_a_linear_chain() -> None:
    # s+ = L s + w: stationary variance N / (1 - L^2), and a Gaussian stays one.
    L, N = 0.8, 0.3
    bounds = uniform_bounds(Constants(L, 0.0, 0.0, 0.0, "analytic"), GAUSSIAN, noise_trace=N)
    variance = sum(N * L ** (2 * k) for k in range(300))
    assert bounds.second_moment == pytest.approx(variance, rel=1e-12)
    assert bounds.fourth_moment == pytest.approx(3 * variance**2, rel=1e-12)
    assert bounds.mean == bounds.cov == 0 and bounds.standing == "certified"


@pytest.mark.parametrize("n, steps", [(1, 11), (2, 6)])
def test_exact_errors_stay_below(n: int, steps: int) -> None:
    contractions = 0
    for seed in range(12):
        system = smooth_system(n, seed, v0=0.1, nonlinearity=0.4)
        constants = system.constants()
        if constants.lipschitz >= 1:
            continue
        contractions += 1
        bounds = uniform_bounds(constants, NoiseLaw(1.0), noise_trace=1.5 * system.v0.sum().item())
        start = Law(system.start.unsqueeze(0), f64([1.0]))
        laws = exact_laws(system, RADEMACHER, steps, start)
        for error in exact_errors(system, system.path(steps), laws):
            assert error.mean <= bounds.mean and error.cov <= bounds.cov
            assert error.second_moment <= bounds.second_moment
            assert error.fourth_moment <= bounds.fourth_moment
    assert contractions >= 8


@pytest.mark.oracle
def test_long_runs_stay_below() -> None:
    steps = 100
    for seed in (0, 1):
        system = smooth_system(2, seed, v0=0.1, nonlinearity=0.3)
        cov = 0.01 * torch.eye(2, dtype=torch.float64)
        bounds = uniform_bounds(
            system.constants(), GAUSSIAN, noise_trace=1.5 * system.v0.sum().item()
        )
        path = system.path(steps)
        estimates, _ = coupled(system, path, gaussian, 10_000, definition_weights(1.0, steps), seed)
        for step in estimates:
            assert not step.mean.exceeds(bounds.mean)
            assert not step.cov.exceeds(bounds.cov)
            assert not step.second_moment.exceeds(bounds.second_moment)
            assert not step.fourth_moment.exceeds(bounds.fourth_moment)
        wide = uniform_bounds(
            system.constants(), GAUSSIAN, noise_trace=0.0, start=StartLaw.gaussian(cov)
        )
        assert wide.second_moment == pytest.approx(0.02)
        assert wide.fourth_moment == pytest.approx(8e-4)


def test_refusals() -> None:
    constants = Constants(1.0, 0.1, 0.1, 0.0, "analytic")
    with pytest.raises(ValueError, match=r"lipschitz=1\.0: uniform bounds need a number < 1"):
        uniform_bounds(constants, GAUSSIAN, noise_trace=1.0)
    with pytest.raises(ValueError, match="noise_trace=nan"):
        uniform_bounds(replace(constants, lipschitz=0.5), GAUSSIAN, noise_trace=math.nan)
    sampled = replace(constants, lipschitz=0.5, provenance="sampled")
    assert uniform_bounds(sampled, GAUSSIAN, noise_trace=1.0).standing == "estimate"
