"""The error recursion against exact sums over all paths of the noise."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from edtorch.bounds import (
    GAUSSIAN,
    Constants,
    NoiseLaw,
    StartLaw,
    bound_errors,
    definition_weights,
    first_order_path,
    horizon_weights,
    value_bound,
)
from edtorch.rewards import QuadraticReward
from edtorch.types import Belief
from edtorch.value.unroll import Horizon
from tests.bounds.systems import (
    FLOOR,
    RADEMACHER,
    THREE_POINT,
    Atoms,
    Law,
    at_start,
    broken,
    exact_errors,
    exact_laws,
    exact_value_error,
    noise_atoms,
    smooth_system,
)
from tests.systems import f64, normal, random_cost


@pytest.mark.parametrize(
    "n, steps, atoms, kurtosis",
    [
        (1, 10, RADEMACHER, 1.0),
        (1, 8, THREE_POINT, 3.0),
        (2, 6, RADEMACHER, 1.0),
        (2, 4, THREE_POINT, 3.0),
        (5, 3, RADEMACHER, 1.0),
    ],
)
@pytest.mark.parametrize("v0", [1e-3, 0.3])
def test_bounds_hold_for_every_exact_error(
    n: int, steps: int, atoms: Atoms, kurtosis: float, v0: float
) -> None:
    for seed in range(6):
        system = smooth_system(n, seed, v0=v0, nonlinearity=0.9)
        path, laws = system.path(steps), exact_laws(system, atoms, steps, at_start(system))
        for weights in (
            definition_weights(0.95, steps),
            horizon_weights(Horizon(steps, 0.05, 0.9, 0.05)),
        ):
            bounds = bound_errors(
                path, system.constants(), noise_law=NoiseLaw(kurtosis), weights=weights
            )
            assert broken(bounds, exact_errors(system, path, laws)) == []
            actual = exact_value_error(system, path, laws, weights)
            assert actual <= bounds.value_summed * (1 + FLOOR) + FLOOR
            assert actual <= bounds.value_adjoint * (1 + FLOOR) + FLOOR
            assert bounds.value == min(bounds.value_summed, bounds.value_adjoint)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_any_start_law_with_its_own_moments(n: int) -> None:
    # The first belief is neither the mean nor the covariance of the law that the process starts in.
    steps = 3 if n < 5 else 2
    for seed in range(6):
        g = torch.Generator().manual_seed(seed)
        system = smooth_system(n, seed, v0=0.05)
        law = Law(system.start + 0.3 * normal(g, 4, n), f64([0.1, 0.2, 0.3, 0.4]))
        belief = Belief(system.start, 0.05 * random_cost(g, n))
        path = system.path(steps, belief)
        laws = exact_laws(system, RADEMACHER, steps, law)
        errors = exact_errors(system, path, laws)
        start = StartLaw(
            errors[0].mean, errors[0].cov, errors[0].second_moment, errors[0].fourth_moment
        )
        weights = definition_weights(0.9, steps)
        bounds = bound_errors(
            path, system.constants(), noise_law=NoiseLaw(1.0), weights=weights, start=start
        )
        assert broken(bounds, errors) == []
        assert exact_value_error(system, path, laws, weights) <= bounds.value


def test_linear_quadratic_systems_have_no_error() -> None:
    # Exact for any start law and any noise: every bound of an error is zero, and D_2 is exact.
    g = torch.Generator().manual_seed(3)
    A, W, S = normal(g, 3, 3), random_cost(g, 3), random_cost(g, 3)
    reward = QuadraticReward(random_cost(g, 3), torch.zeros(3, 3, dtype=torch.float64))
    path = first_order_path(
        Belief(normal(g, 3), S),
        lambda s: s @ A.T,
        lambda s: W.expand(*s.shape[:-1], 3, 3),
        torch.zeros_like,
        reward=reward,
        steps=6,
    )
    constants = Constants(torch.linalg.matrix_norm(A, ord=2).item(), 0.0, 0.0, 0.0, "analytic")
    bounds = bound_errors(
        path,
        constants,
        noise_law=GAUSSIAN,
        weights=definition_weights(1.0, 6),
        start=StartLaw.gaussian(S),
    )
    assert bounds.mean == bounds.cov == bounds.reward == (0.0,) * 7
    assert bounds.value == bounds.value_summed == 0
    traces = path.cov.diagonal(dim1=-2, dim2=-1).sum(-1).tolist()
    assert bounds.second_moment == pytest.approx(traces, rel=1e-12)


def test_an_initial_error_of_the_covariance_is_carried_exactly() -> None:
    # s+ = L s + w, r = -s^2: the value is off by sum gamma^t L^(2t) times the first covariance's.
    L, steps, off = 0.8, 4, 0.3
    path = first_order_path(
        Belief(f64([1.0]), f64([[0.5]])),
        lambda s: L * s,
        lambda s: torch.ones((*s.shape, 1), dtype=torch.float64),
        torch.zeros_like,
        reward=QuadraticReward(f64([[1.0]]), f64([[0.0]])),
        steps=steps,
    )
    bounds = bound_errors(
        path,
        Constants(L, 0.0, 0.0, 0.0, "analytic"),
        noise_law=GAUSSIAN,
        weights=definition_weights(0.9, steps),
        start=StartLaw(0.0, off, 0.8, 3 * 0.8**2),
    )
    exact = off * sum(0.9**t * L ** (2 * t) for t in range(steps + 1))
    assert (bounds.value_summed, bounds.value_adjoint) == pytest.approx((exact, exact), rel=1e-13)


def test_scalar_moments_are_attained_without_curvature() -> None:
    # s+ = L s + w in one dimension with constant nu: D_4 follows its recursion with equality.
    L, nu, steps = 0.8, 0.3, 6

    def still(s: Tensor) -> Tensor:
        return torch.full((*s.shape, 1), nu, dtype=torch.float64)

    path = first_order_path(
        Belief(f64([1.0]), f64([[0.0]])),
        lambda s: L * s,
        still,
        torch.zeros_like,
        reward=QuadraticReward(f64([[1.0]]), f64([[0.0]])),
        steps=steps,
    )
    constants = Constants(L, 0.0, 0.0, 0.0, "analytic")
    weights = definition_weights(1.0, steps)
    bounds = bound_errors(path, constants, noise_law=NoiseLaw(1.8), weights=weights)
    # A sum of independent terms L^k w: its fourth moment is 3 (sum of variances)^2 less what each
    # term's kurtosis lacks of 3.
    for t in range(steps + 1):
        variances = [nu * L ** (2 * k) for k in range(t)]
        exact = 3 * sum(variances) ** 2 - 1.2 * sum(v * v for v in variances)
        assert bounds.fourth_moment[t] == pytest.approx(exact, rel=1e-12)
        assert bounds.second_moment[t] == pytest.approx(sum(variances), rel=1e-12)


def test_skewed_noise_needs_its_third_moment() -> None:
    # z takes 2 with probability 1/5 and -1/2 with 4/5: E z^3 = 3/2, E z^4 = 13/4.
    skewed = ((2.0, 0.2), (-0.5, 0.8))
    z = noise_atoms(skewed, 1)
    third, fourth = z.mean(z.states**3).item(), z.mean(z.states**4).item()
    assert (z.mean(z.states**2).item(), third, fourth) == pytest.approx((1, 1.5, 3.25))
    for seed in range(8):
        system = smooth_system(1, seed, v0=0.3)
        path, weights = system.path(8), definition_weights(0.95, 8)
        errors = exact_errors(system, path, exact_laws(system, skewed, 8, at_start(system)))
        law = NoiseLaw(fourth, third * (1.5 * system.v0.item()) ** 1.5)
        bounds = bound_errors(path, system.constants(), noise_law=law, weights=weights)
        assert broken(bounds, errors) == []
    # s+ = L s + w from s = 1 where s~ = 0: the third moment adds 4 L kappa, with equality.
    L = 0.9
    path = first_order_path(
        Belief(f64([0.0]), f64([[0.0]])),
        lambda s: L * s,
        lambda s: torch.ones((*s.shape, 1), dtype=torch.float64),
        torch.zeros_like,
        reward=QuadraticReward(f64([[1.0]]), f64([[0.0]])),
        steps=1,
    )
    exact = Law(L + z.states, z.weights).distance_moment(f64([0.0]), 4)
    with_third, without = (
        bound_errors(
            path,
            Constants(L, 0.0, 0.0, 0.0, "analytic"),
            noise_law=law,
            weights=[1.0, 1.0],
            start=StartLaw(1.0, 0.0, 1.0, 1.0),
        ).fourth_moment[1]
        for law in (NoiseLaw(3.25, 1.5), NoiseLaw(3.25))
    )
    assert with_third == pytest.approx(exact, rel=1e-14)
    assert without == pytest.approx(exact - 4 * L * 1.5, rel=1e-14)


def test_sums_and_theorem_4_agree_on_the_value() -> None:
    system, steps = smooth_system(2, 1), 6
    path = system.path(steps)
    weights = definition_weights(0.9, steps)
    bounds = bound_errors(path, system.constants(), noise_law=GAUSSIAN, weights=weights)
    tighter = value_bound(discount=0.9, reward_errors=bounds.reward)
    assert bounds.value_summed == pytest.approx(tighter, rel=1e-14)
    # V by definition is r'_0 + gamma V by Fig. 1; the start's reward has no error.
    figure = bound_errors(
        path,
        system.constants(),
        noise_law=GAUSSIAN,
        weights=horizon_weights(Horizon(steps, 1.0, 0.9, 1.0)),
    )
    assert bounds.value_summed == pytest.approx(0.9 * figure.value_summed, rel=1e-13)
    assert bounds.value_adjoint == pytest.approx(0.9 * figure.value_adjoint, rel=1e-13)


def test_no_steps() -> None:
    system = smooth_system(2, 0)
    bounds = bound_errors(
        system.path(0), system.constants(), noise_law=GAUSSIAN, weights=definition_weights(0.9, 0)
    )
    assert bounds.reward == (0.0,) and bounds.value == 0


def test_bounds_beyond_the_range_of_floats_are_infinite() -> None:
    system = smooth_system(1, 0)
    explosive = replace(system.constants(), lipschitz=1e40)
    bounds = bound_errors(
        system.path(12), explosive, noise_law=GAUSSIAN, weights=definition_weights(0.9, 12)
    )
    assert bounds.value == bounds.fourth_moment[-1] == math.inf
    assert not any(math.isnan(e) for e in bounds.mean + bounds.cov + bounds.reward)
