"""Bayesian linear regression against the evidence written out."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from edtorch.errors import FitError
from edtorch.model.evidence import Evidence, Posterior, Updates, ard, ridge

EVERY = torch.ones(1, 3, dtype=torch.bool)


def _problem(rows: int = 30, noise: float = 0.3) -> tuple[Tensor, Tensor, Tensor]:
    """X ``[N, 3]``, y ``[1, N]`` and share ``[1, N]``; the third column does not matter."""
    generator = torch.Generator().manual_seed(4)
    X = torch.randn(rows, 3, generator=generator, dtype=torch.float64)
    share = 0.5 + torch.rand(1, rows, generator=generator, dtype=torch.float64)
    weight = torch.tensor([1.0, -2.0, 0.0], dtype=torch.float64)
    error = noise * torch.randn(1, rows, generator=generator, dtype=torch.float64)
    return X, X @ weight + error / share.sqrt(), share


def _log_evidence(X: Tensor, y: Tensor, share: Tensor, alpha: Tensor, beta: Tensor) -> Tensor:
    """log p(y | alpha, beta), y ~ N(0, X diag(1 / alpha) X' + diag(1 / (beta share)))."""
    cov = X @ torch.diag(1 / alpha) @ X.mT + torch.diag(1 / (beta * share[0]))
    normal = torch.distributions.MultivariateNormal(torch.zeros_like(y[0]), cov)
    return normal.log_prob(y[0])


def _precisions(X: Tensor, found: Posterior, share: Tensor) -> tuple[Tensor, Tensor]:
    """alpha ``[3]`` and beta, read off the posterior: P^-1 = diag(alpha) + beta X'SX."""
    beta = 1 / found.noise[0]
    gram = X.mT @ torch.diag(share[0]) @ X
    return (torch.linalg.inv(found.cov[0]) - beta * gram).diagonal(), beta


def test_posterior_is_that_of_its_precisions() -> None:
    X, y, share = _problem()
    found = ard(X, y, share, EVERY)
    alpha, beta = _precisions(X, found, share)
    weighted = beta * X.mT @ torch.diag(share[0])
    expected = torch.linalg.solve(torch.diag(alpha) + weighted @ X, weighted @ y[0])
    assert_close(found.weight[0], expected, rtol=1e-7, atol=1e-9)


def _slope(X: Tensor, y: Tensor, share: Tensor, alpha: Tensor, beta: Tensor) -> Tensor:
    """Of the log evidence, by the logarithms of the precisions."""
    logs = torch.cat([alpha, beta[None]]).log().requires_grad_()
    total = _log_evidence(X, y, share, logs[:-1].exp().expand(3), logs[-1].exp())
    return torch.autograd.grad(total, logs)[0]


def test_ard_climbs_to_the_maximum_of_the_evidence() -> None:
    """Against a grid about it and far around it, and by the gradient."""
    X, y, share = _problem()
    found = ard(X, y, share, EVERY, updates=Updates(1000))
    alpha, beta = _precisions(X, found, share)
    reached = _log_evidence(X, y, share, alpha, beta)
    steps = torch.tensor([-5.0, -0.1, 0.1, 1.0], dtype=torch.float64).exp()
    for factor in torch.cartesian_prod(steps, steps, steps, steps):
        assert _log_evidence(X, y, share, alpha * factor[:3], beta * factor[3]) < reached
    slope = _slope(X, y, share, alpha, beta)
    assert_close(slope, torch.zeros_like(slope), rtol=0, atol=1e-5)
    assert alpha[2] > 10 * alpha[0]  # the column that does not matter


def test_ridge_is_a_stationary_point_of_the_evidence() -> None:
    """In units in which the columns have mean square 1, where alpha is one number."""
    X, y, share = _problem()
    X = X / ((share @ X.square()) / share.sum()).sqrt()
    found = ridge(X, y, share, EVERY, updates=Updates(300))
    alpha, beta = _precisions(X, found, share)
    assert_close(alpha, alpha.mean().expand(3), rtol=1e-6, atol=0)
    slope = _slope(X, y, share, alpha[:1], beta)
    assert_close(slope, torch.zeros_like(slope), rtol=0, atol=1e-5)


@pytest.mark.parametrize("evidence", [ard, ridge])
def test_units_and_the_order_of_rows_change_nothing(evidence: Evidence) -> None:
    X, y, share = _problem()
    found = evidence(X, y, share, EVERY)
    factor = torch.tensor([10.0, 1e-3, 7.0], dtype=torch.float64)
    other = evidence(X * factor, 50 * y, 3 * share, EVERY)
    assert_close(other.weight, 50 * found.weight / factor, rtol=1e-9, atol=1e-9)
    assert_close(other.noise, 3 * 2500 * found.noise, rtol=1e-9, atol=0)
    cov = 2500 * found.cov / factor / factor[:, None]
    assert_close(other.cov, cov, rtol=1e-6, atol=1e-9)
    order = torch.randperm(30, generator=torch.Generator().manual_seed(0))
    mixed = evidence(X[order], y[:, order], share[:, order], EVERY)
    assert_close(mixed.weight, found.weight, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("evidence", [ard, ridge])
def test_what_is_not_allowed_is_zero_and_sure(evidence: Evidence) -> None:
    X, y, share = _problem()
    allowed = torch.tensor([[True, False, True]])
    found = evidence(X, y, share, allowed)
    alone = evidence(X[:, [0, 2]], y, share, torch.ones(1, 2, dtype=torch.bool))
    assert float(found.weight[0, 1]) == 0 and not found.cov[0, 1].any()
    assert_close(found.weight[0, [0, 2]], alone.weight[0], rtol=1e-2, atol=1e-2)


def test_outputs_are_fitted_apart() -> None:
    X, y, share = _problem()
    both = ard(X, torch.cat([y, y.flip(-1)]), torch.cat([share, share**2]), EVERY.expand(2, 3))
    for i, (target, weight) in enumerate([(y, share), (y.flip(-1), share**2)]):
        alone = ard(X, target, weight, EVERY)
        assert_close(both.weight[i], alone.weight[0], rtol=1e-12, atol=1e-12)
        assert_close(both.cov[i], alone.cov[0], rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("evidence", [ard, ridge])
def test_more_columns_than_rows_and_columns_of_zero(evidence: Evidence) -> None:
    generator = torch.Generator().manual_seed(1)
    X = torch.randn(10, 40, generator=generator, dtype=torch.float64)
    X[:, 3] = 0
    y = (X[:, 0] - X[:, 1])[None]
    found = evidence(X, y, torch.ones_like(y), torch.ones(1, 40, dtype=torch.bool))
    assert bool(found.cov.isfinite().all()) and float(found.weight[0, 3]) == 0
    assert float(found.cov[0, 3, 3]) <= float(y.square().mean())


def test_draws_have_the_posterior_as_their_distribution() -> None:
    X, y, share = _problem(rows=8)
    found = ridge(X, y, share, torch.tensor([[True, True, False]]))
    generator = torch.Generator().manual_seed(1)
    normals = torch.randn(20_000, 1, 3, generator=generator, dtype=torch.float64)
    drawn = found.drawn(normals, inflation=2.0)[:, 0]
    assert not drawn[:, 2].any()
    assert_close(drawn.mean(0), found.weight[0], rtol=0, atol=0.02)
    assert_close(drawn.mT.cov(), 4 * found.cov[0], rtol=0.05, atol=1e-3)
    assert torch.equal(found.drawn(normals[:1], 0.0)[0], found.weight)


def test_refuses_numbers_that_break() -> None:
    X, y, share = _problem()
    with pytest.raises(FitError, match=r"the fit broke: 30 transitions .* not finite") as error:
        ard(X * 1e200, y, share, EVERY)
    assert "\n" not in str(error.value)
