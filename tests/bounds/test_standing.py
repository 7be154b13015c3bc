"""When a bound is a certificate, when an estimate, and when there is none."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from edtorch.bounds import (
    GAUSSIAN,
    Constants,
    ErrorBounds,
    ModelError,
    NoiseLaw,
    NonSmoothDynamics,
    NotCertified,
    StartLaw,
    bound_errors,
    definition_weights,
    first_order_path,
    sampled_constants,
    tube_radii,
    uniform_bounds,
)
from edtorch.types import Belief
from tests.bounds.systems import SmoothSystem, smooth_system
from tests.systems import f64, normal

STEPS = 4


def bounds_with(constants: Constants, error: ModelError | None = None) -> ErrorBounds:
    return bound_errors(
        smooth_system(2, 0).path(STEPS),
        constants,
        noise_law=GAUSSIAN,
        weights=definition_weights(0.9, STEPS),
        model_error=error or ModelError(0.0, 0.0, "analytic"),
    )


def sample(system: SmoothSystem, count: int, spread: float) -> Constants:
    states = spread * normal(torch.Generator().manual_seed(0), count, system.n)
    return sampled_constants(
        system.mu, system.nu, system.policy, reward=system.reward, states=states
    )


def test_suprema_certify() -> None:
    constants = smooth_system(2, 0).constants()
    for provenance in ("analytic", "interval"):
        bounds = bounds_with(replace(constants, provenance=provenance))
        assert bounds.standing == "certified" and bounds.reasons == ()
        assert bounds.certified_value() == bounds.value > 0
        assert str(bounds).startswith("value error bound (certified)")


def test_sampled_constants_only_estimate() -> None:
    bounds = bounds_with(sample(smooth_system(2, 0), 50, 1.0))
    assert bounds.standing == "estimate" and bounds.value > 0
    assert str(bounds).startswith("value error estimate")
    with pytest.raises(NotCertified, match="sampled states"):
        bounds.certified_value()


def test_one_sampled_step_or_a_sampled_model_error_suffices() -> None:
    constants = smooth_system(2, 0).constants()
    one = [replace(constants, provenance="sampled" if t == 2 else "analytic") for t in range(5)]
    bounds = bound_errors(
        smooth_system(2, 0).path(STEPS),
        one,
        noise_law=GAUSSIAN,
        weights=definition_weights(0.9, STEPS),
    )
    assert bounds.standing == "estimate"
    bounds = bounds_with(constants, ModelError(0.1, 0.0, "sampled"))
    with pytest.raises(NotCertified, match="model's error"):
        bounds.certified_value()


@pytest.mark.parametrize("provenance", ["analytic", "sampled"])
def test_dynamics_that_are_not_smooth_have_no_bound(provenance: str) -> None:
    constants = replace(smooth_system(2, 0).constants(), smooth=False, provenance=provenance)
    with pytest.raises(NonSmoothDynamics):
        bounds_with(constants)
    with pytest.raises(NonSmoothDynamics):
        uniform_bounds(replace(constants, lipschitz=0.5), GAUSSIAN, noise_trace=1.0)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_samples_stay_below_suprema_and_come_near(n: int) -> None:
    for seed in range(3):
        system = smooth_system(n, seed)
        exact = system.constants()
        found = sample(system, 3000 if n < 5 else 300, 4.0)
        assert found.provenance == "sampled"
        for name in (
            "lipschitz",
            "curvature",
            "noise_slope",
            "noise_trace_slope",
            "noise_curvature",
            "reward_third",
        ):
            share = getattr(found, name) / getattr(exact, name)
            assert share <= 1 + 1e-12, name
            assert share > (0.99 if n == 1 else 0.5), name


def test_sampling_sees_the_policy_and_refuses_bad_states() -> None:
    # r(s, a) = -a with a = s^3: the third derivative of r_pi is -6.
    def cost(state: Tensor, action: Tensor) -> Tensor:
        return -action.sum(-1)

    def still(s: Tensor) -> Tensor:
        return torch.ones((*s.shape, 1), dtype=torch.float64)

    found = sampled_constants(
        torch.sin, still, lambda s: s**3, reward=cost, states=f64([[0.1], [-1.0]])
    )
    assert found.reward_third == pytest.approx(6) and found.noise_slope == 0
    assert found.curvature == pytest.approx(math.sin(1))
    with pytest.raises(ValueError, match=r"expected \[N, n\]"):
        sampled_constants(torch.sin, still, torch.sin, reward=cost, states=f64([0.1]))
    with pytest.raises(ValueError, match="behind lipschitz are not finite"):
        sampled_constants(torch.sqrt, still, torch.sin, reward=cost, states=f64([[0.0]]))


def test_impossible_constants_are_refused() -> None:
    good = smooth_system(1, 0).constants()
    for name in ("lipschitz", "curvature", "noise_slope", "reward_third", "noise_trace_slope"):
        for bad in (-1.0, math.nan, math.inf):
            with pytest.raises(ValueError, match=f"{name}={bad}"):
                replace(good, **{name: bad})
    with pytest.raises(ValueError, match="noise_curvature=nan"):
        replace(good, noise_curvature=math.nan)
    with pytest.raises(ValueError, match="provenance='guess'"):
        replace(good, **{"provenance": "guess"})
    with pytest.raises(ValueError, match=r"kurtosis=0\.5"):
        NoiseLaw(0.5)
    with pytest.raises(ValueError, match=r"cov=-1\.0"):
        ModelError(0.0, -1.0, "analytic")


def test_an_unknown_trace_slope_is_at_most_the_root_of_n_times_the_slope() -> None:
    unknown = replace(smooth_system(5, 0).constants(), noise_trace_slope=None)
    known = smooth_system(5, 0).constants()
    assert known.trace_slope(5) <= unknown.trace_slope(5) == math.sqrt(5) * unknown.noise_slope


def test_impossible_requests_are_refused() -> None:
    system = smooth_system(2, 0)
    path, constants = system.path(STEPS), system.constants()
    weights = definition_weights(0.9, STEPS)
    with pytest.raises(ValueError, match="4 weights, expected 5"):
        bound_errors(path, constants, noise_law=GAUSSIAN, weights=weights[1:])
    with pytest.raises(ValueError, match="2 constants"):
        bound_errors(path, [constants] * 2, noise_law=GAUSSIAN, weights=weights)
    with pytest.raises(ValueError, match="expected finite numbers >= 0"):
        bound_errors(path, constants, noise_law=GAUSSIAN, weights=[-1.0, *weights[1:]])
    wide = system.path(STEPS, Belief(system.start, 0.1 * torch.eye(2).double()))
    with pytest.raises(ValueError, match="pass start"):
        bound_errors(wide, constants, noise_law=GAUSSIAN, weights=weights)
    with pytest.raises(ValueError, match="below the trace"):
        bound_errors(wide, constants, noise_law=GAUSSIAN, weights=weights, start=StartLaw.point())
    with pytest.raises(ValueError, match="noise_radius=inf"):
        tube_radii(path.mean, lambda s, size: 1.0, noise_radius=math.inf)


def test_an_unsound_path_is_refused_where_it_began() -> None:
    system = smooth_system(2, 0)

    def path(start: Belief, steps: int = STEPS, blow: float = 1.0) -> None:
        first_order_path(
            start,
            lambda s: system.mu(s) * blow,
            system.nu,
            system.policy,
            reward=system.reward,
            steps=steps,
        )

    zero = torch.zeros(2, 2, dtype=torch.float64)
    with pytest.raises(ValueError, match="mean is not finite at step 1"):
        path(Belief(system.start, zero), blow=math.inf)
    with pytest.raises(ValueError, match="expected one state"):
        path(Belief(system.start.expand(3, 2), zero.expand(3, 2, 2)))
    with pytest.raises(ValueError, match="steps=-1"):
        path(Belief(system.start, zero), steps=-1)
    broken = replace(system.path(2), cov=system.path(2).cov.float())
    with pytest.raises(ValueError, match=r"cov is torch\.float32"):
        broken.require_sound()
