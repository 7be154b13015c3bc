"""Every estimator on systems with known answers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from edtorch.model.fit import (
    AbsoluteError,
    BayesianLeastSquares,
    Fit,
    NormalisedSquaredError,
    RecursiveLeastSquares,
    SquaredError,
)
from tests.systems import normal

UNIT = torch.tensor(1.0, dtype=torch.float64)


def run(fit: Fit, data: Iterator[tuple[Tensor, Tensor]], n: int, k: int) -> Tensor:
    weight = torch.zeros(1, n, k, dtype=torch.float64)
    memory = fit.initial(weight)
    for phi, y in data:
        fitted = fit.update(weight, memory, phi, y, UNIT)
        weight, memory = fitted.weight, fitted.memory
    return weight[0]


def with_outliers(count: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Mostly 1, one in five 11: the median is 1, the mean 3."""
    g = torch.Generator().manual_seed(0)
    phi = torch.ones(1, 1, dtype=torch.float64)
    for _ in range(count):
        y = 11.0 if float(torch.rand((), generator=g)) < 0.2 else 1.0
        yield phi, torch.full((1, 1), y, dtype=torch.float64)


def test_absolute_error_finds_the_median_and_squared_error_the_mean() -> None:
    assert float(run(AbsoluteError(0.005), with_outliers(6000), 1, 1)) == pytest.approx(1, abs=0.1)
    # An average over about 1 / rate = 1000 samples of standard deviation 4.
    squared = float(run(SquaredError(0.001), with_outliers(12_000), 1, 1))
    assert squared == pytest.approx(3, abs=0.5)


def noiseless(count: int, true: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    g = torch.Generator().manual_seed(1)
    for _ in range(count):
        phi = normal(g, 1, true.shape[1])
        yield phi, phi @ true.T


@pytest.mark.parametrize(
    "fit",
    [
        SquaredError(0.1),
        NormalisedSquaredError(0.5),
        RecursiveLeastSquares(1e6),
        BayesianLeastSquares(),
    ],
)
def test_recovers_a_linear_map(fit: Fit) -> None:
    true = normal(torch.Generator().manual_seed(2), 3, 4)
    assert torch.allclose(run(fit, noiseless(600, true), 3, 4), true, atol=1e-5)


def test_absolute_error_comes_within_its_step() -> None:
    true = normal(torch.Generator().manual_seed(2), 3, 4)
    found = run(AbsoluteError(0.002), noiseless(6000, true), 3, 4)
    assert torch.allclose(found, true, atol=0.02)


def test_gradient_rules_follow_their_gradients() -> None:
    g = torch.Generator().manual_seed(3)
    weight = normal(g, 1, 2, 3).requires_grad_()
    phi, y = normal(g, 1, 3), normal(g, 1, 2)
    residual = y - (weight @ phi.unsqueeze(-1)).squeeze(-1)
    for fit, loss in (
        (AbsoluteError(0.25), residual.abs().sum()),
        (SquaredError(0.25), 0.5 * residual.square().sum()),
    ):
        (gradient,) = torch.autograd.grad(loss, weight, retain_graph=True)
        step = fit.update(weight.detach(), {}, phi, y, UNIT * 0.1).weight - weight.detach()
        assert torch.allclose(step, -0.025 * gradient, rtol=1e-12)


def test_normalised_steps_do_not_depend_on_the_scale_of_the_features() -> None:
    g = torch.Generator().manual_seed(4)
    phi, y = normal(g, 1, 3), normal(g, 1, 2)
    weight = torch.zeros(1, 2, 3, dtype=torch.float64)
    fit = NormalisedSquaredError(1.0, floor=1e-9)
    for scale in (1.0, 1e3):
        new = fit.update(weight, {}, scale * phi, y, UNIT).weight
        assert torch.allclose((new @ (scale * phi).unsqueeze(-1)).squeeze(-1), y, rtol=1e-6)


@pytest.mark.parametrize("forgetting", [1.0, 0.97])
def test_recursive_least_squares_equals_the_batch_solution(forgetting: float) -> None:
    g = torch.Generator().manual_seed(5)
    count, n, k, prior = 120, 2, 4, 50.0
    phi, y = normal(g, count, k), normal(g, count, n)
    found = run(
        RecursiveLeastSquares(prior, forgetting),
        ((phi[i : i + 1], y[i : i + 1]) for i in range(count)),
        n,
        k,
    )
    age = torch.arange(count - 1, -1, -1, dtype=torch.float64)
    w = (forgetting**age).unsqueeze(-1)
    # The prior is forgotten like a datum of before the first one.
    normal_matrix = phi.T @ (w * phi) + forgetting**count / prior * torch.eye(k).double()
    batch = torch.linalg.solve(normal_matrix, phi.T @ (w * y)).T
    assert torch.allclose(found, batch, rtol=1e-9, atol=1e-11)


def test_recursive_least_squares_keeps_its_matrix_symmetric_and_positive() -> None:
    g = torch.Generator().manual_seed(6)
    fit = RecursiveLeastSquares(1e6)
    weight = torch.zeros(1, 1, 5, dtype=torch.float64)
    memory = fit.initial(weight)
    direction = normal(g, 1, 5)
    for _ in range(20_000):
        # Nearly always the same direction: the worst that a loop in equilibrium offers.
        phi = direction + 1e-6 * normal(g, 1, 5)
        memory = fit.update(weight, memory, phi, phi[:, :1], UNIT).memory
    P = memory["P"][0]
    assert torch.equal(P, P.T)
    assert float(torch.linalg.eigvalsh(P)[0]) > 0


def test_bayesian_least_squares_is_ridge_regression_with_the_prior_of_greatest_evidence() -> None:
    g = torch.Generator().manual_seed(8)
    count, n, k = 30, 2, 4
    phi, y = normal(g, count, k), normal(g, count, n)
    fit = BayesianLeastSquares()
    weight = torch.zeros(1, n, k, dtype=torch.float64)
    memory = fit.initial(weight)
    for i in range(count):
        fitted = fit.update(weight, memory, phi[i : i + 1], y[i : i + 1], UNIT)
        weight, memory = fitted.weight, fitted.memory

    def log_evidence(a: float) -> float:
        # y ~ N(0, sigma^2 (I + phi phi' / a)), sigma^2 at its best: from the density itself.
        cov = torch.eye(count).double() + phi @ phi.T / a
        squares = (y * torch.linalg.solve(cov, y)).sum(0)
        spread = n * torch.logdet(cov) + count * squares.log().sum()
        return -0.5 * float(spread)

    grid = torch.logspace(3, -6, fit.priors, dtype=torch.float64).tolist()
    best = max(grid, key=log_evidence)
    ridge = torch.linalg.inv(phi.T @ phi + best * torch.eye(k).double())
    assert torch.allclose(memory["P"][0], ridge, rtol=1e-9)
    assert torch.allclose(weight[0], (ridge @ phi.T @ y).T, rtol=1e-9)


def test_the_evidence_shrinks_weights_that_are_noise_and_leaves_those_that_are_not() -> None:
    g = torch.Generator().manual_seed(9)
    fit = BayesianLeastSquares()
    sizes = []
    for true in (torch.zeros(2, 8).double(), 3 * normal(g, 2, 8)):
        data = (
            (phi, phi @ true.T + normal(g, 1, 2)) for phi in (normal(g, 1, 8) for _ in range(25))
        )
        found = run(fit, data, 2, 8)
        sizes.append((float(found.norm()), float(true.norm())))
    assert sizes[0][0] < 0.6
    assert sizes[1][0] == pytest.approx(sizes[1][1], rel=0.15)


def test_rates_are_multiplied_with_the_unit() -> None:
    phi, y = torch.ones(1, 1).double(), torch.ones(1, 1).double()
    weight = torch.zeros(1, 1, 1).double()
    for fit in (AbsoluteError(2.0), SquaredError(2.0)):
        assert float(fit.update(weight, {}, phi, y, UNIT * 0.01).weight) == pytest.approx(0.02)


def test_a_population_fits_as_its_members_do() -> None:
    g = torch.Generator().manual_seed(7)
    weight, phi, y = normal(g, 4, 2, 3), normal(g, 4, 3), normal(g, 4, 2)
    for fit in (AbsoluteError(0.1), SquaredError(0.1), RecursiveLeastSquares(10.0)):
        together = fit.update(weight, fit.initial(weight), phi, y, UNIT)
        for b in range(4):
            one = slice(b, b + 1)
            alone = fit.update(weight[one], fit.initial(weight[one]), phi[one], y[one], UNIT)
            assert torch.equal(together.weight[one], alone.weight)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AbsoluteError(-1.0), "rate=-1.0"),
        (lambda: SquaredError(float("nan")), "rate=nan"),
        (lambda: NormalisedSquaredError(1.0, floor=0.0), "floor=0.0"),
        (lambda: RecursiveLeastSquares(prior=0.0), "prior=0.0"),
        (lambda: RecursiveLeastSquares(forgetting=1.1), "forgetting=1.1"),
    ],
)
def test_refuses_the_impossible(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
