"""Fourth moments against exact sums and Gaussian quadrature, and what a quadratic map does."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.bounds import StartLaw, fourth_moment, gaussian_fourth_moment
from tests.bounds.systems import RADEMACHER, THREE_POINT, Atoms, Law, noise_atoms
from tests.systems import f64, normal, random_cost

UNIFORM_ATOMS = ((-math.sqrt(1.8), 5 / 18), (0.0, 8 / 18), (math.sqrt(1.8), 5 / 18))
"""Gauss-Legendre nodes of a uniform law of variance 1: polynomials up to degree 5 are exact."""


def gauss_hermite(n: int, degree: int) -> Law:
    """Nodes and weights of N(0, I), exact for polynomials up to 2 degree - 1 in each variable."""
    x, w = np.polynomial.hermite_e.hermegauss(degree)
    atoms = tuple(zip(x.tolist(), (w / w.sum()).tolist(), strict=True))
    return noise_atoms(atoms, n)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_gaussian_fourth_moment(n: int) -> None:
    g = torch.Generator().manual_seed(n)
    z = gauss_hermite(n, 5)
    for _ in range(5):
        cov, offset = random_cost(g, n), normal(g, n)
        law = Law(offset + z.states @ torch.linalg.cholesky(cov).T, z.weights)
        zero = torch.zeros(n, dtype=torch.float64)
        exact = law.distance_moment(zero, 4)
        assert gaussian_fourth_moment(offset, cov) == pytest.approx(exact, rel=1e-12)
        centred = law.distance_moment(offset, 4)
        assert fourth_moment(cov) == pytest.approx(centred, rel=1e-12)
        start = StartLaw.gaussian(cov)
        assert start.fourth_moment == pytest.approx(centred, rel=1e-12)
        assert start.second_moment == pytest.approx(law.distance_moment(offset, 2), rel=1e-12)


@pytest.mark.parametrize(
    "atoms, kurtosis", [(RADEMACHER, 1.0), (THREE_POINT, 3.0), (UNIFORM_ATOMS, 1.8)]
)
def test_fourth_moment_of_independent_components(atoms: Atoms, kurtosis: float) -> None:
    g = torch.Generator().manual_seed(0)
    z = noise_atoms(atoms, 3)
    assert z.mean(z.states**4)[0].item() == pytest.approx(kurtosis)
    U, _ = torch.linalg.qr(normal(g, 3, 3))
    v = torch.rand(3, generator=g, dtype=torch.float64)
    law = Law(z.states * v.sqrt() @ U.T, z.weights)
    exact = law.distance_moment(torch.zeros(3, dtype=torch.float64), 4)
    assert fourth_moment(U * v @ U.T, kurtosis) == pytest.approx(exact, rel=1e-12)


def test_the_fourth_moment_of_a_uniform_law() -> None:
    g = torch.Generator().manual_seed(0)
    z = math.sqrt(12) * (torch.rand(400_000, 2, generator=g, dtype=torch.float64) - 0.5)
    v = f64([0.3, 2.0])
    samples = ((z * v.sqrt()) ** 2).sum(-1) ** 2
    se = (samples.std() / math.sqrt(len(samples))).item()
    gaussian = fourth_moment(torch.diag(v))
    exact = fourth_moment(torch.diag(v), 1.8)
    assert abs(samples.mean().item() - exact) < 4 * se < abs(gaussian - exact)


def test_a_quadratic_map_of_a_gaussian() -> None:
    # mu(s~ + d) = J d + 1/2 H[d, d], d ~ N(e, C): the mean and covariance that (T1), (T2) bound.
    g = torch.Generator().manual_seed(1)
    n, z = 3, gauss_hermite(3, 4)
    J, C, e = normal(g, n, n), random_cost(g, n), normal(g, n)
    H = normal(g, n, n, n)
    H = H + H.mT

    def quadratic(d: Tensor) -> Tensor:
        return d @ J.T + 0.5 * torch.einsum("ijk,aj,ak->ai", H, d, d)

    d = e + z.states @ torch.linalg.cholesky(C).T
    mean, cov = Law(quadratic(d), z.weights).moments()
    bent = J + torch.einsum("ijk,k->ij", H, e)
    exact_mean = J @ e + 0.5 * torch.einsum("ijk,jk->i", H, C + torch.outer(e, e))
    traces = torch.einsum("iab,bc,jcd,da->ij", H, C, H, C)
    assert torch.allclose(mean, exact_mean, rtol=1e-12)
    assert torch.allclose(cov, bent @ C @ bent.T + 0.5 * traces, rtol=1e-12)


def test_a_start_law_must_fit_the_first_covariance() -> None:
    cov = torch.eye(2, dtype=torch.float64)
    StartLaw(0.0, 0.0, 2.0, 8.0).require_consistent(cov)
    StartLaw(0.0, math.sqrt(2), 0.0, 0.0).require_consistent(cov)
    with pytest.raises(ValueError, match=r"second_moment=1\.0 is below the trace 2"):
        StartLaw(0.0, 0.0, 1.0, 8.0).require_consistent(cov)
    with pytest.raises(ValueError, match="mean_error=nan"):
        StartLaw(math.nan, 0.0, 1.0, 8.0)
