"""nu~: moving averages by hand, positive semidefinite, calibrated on held-out transitions."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.model.fit import BayesianLeastSquares, Fit, RecursiveLeastSquares
from edtorch.model.noise import BayesianNoise, LinearNoise, Noise, ResidualNoise
from tests.systems import f64, normal

ONE = torch.tensor(1.0, dtype=torch.float64)
N, K = 2, 3


def outer(e: Tensor) -> Tensor:
    return e.unsqueeze(-1) * e.unsqueeze(-2)


def learn(
    fit: Fit, noise: Noise, samples: int, seed: int, spread: bool, batch: int = 40
) -> tuple[Tensor, dict[str, Tensor], Tensor]:
    """A batch of systems y = W phi + e learned from some samples; weights, memory, true weights.

    The noise has a full covariance; with ``spread`` its size grows with phi_1.
    """
    g = torch.Generator().manual_seed(seed)
    true = normal(g, batch, N, K)
    weight = torch.zeros(batch, N, K, dtype=torch.float64)
    memory = fit.initial(weight)
    nu = noise.initial(weight)
    for _ in range(samples):
        phi, y = sample(g, true, spread)
        fitted = fit.update(weight, memory, phi, y, ONE)
        nu = noise.update(nu, outer(fitted.residual), phi, memory, ONE)
        weight, memory = fitted.weight, fitted.memory
    return weight, nu, true


ROOT = torch.tensor([[0.3, 0.0], [0.2, 0.1]], dtype=torch.float64)


def sample(g: torch.Generator, true: Tensor, spread: bool) -> tuple[Tensor, Tensor]:
    phi = normal(g, true.shape[0], K)
    e = normal(g, true.shape[0], N) @ ROOT.T
    if spread:
        e = e * (0.2 + phi[:, :1].square()).sqrt()
    return phi, (true @ phi.unsqueeze(-1)).squeeze(-1) + e


def chi_square(
    weight: Tensor, noise: Noise, memory: dict[str, Tensor], true: Tensor, spread: bool
) -> float:
    """Mean of e' nu~^-1 e over held-out samples, divided by its expectation n."""
    g = torch.Generator().manual_seed(99)
    total = 0.0
    for _ in range(200):
        phi, y = sample(g, true, spread)
        e = y - (weight @ phi.unsqueeze(-1)).squeeze(-1)
        solved = torch.linalg.solve(noise.covariance(memory, phi), e)
        total += float((e * solved).sum(-1).mean())
    return total / 200 / N


@pytest.mark.oracle
def test_residual_noise_is_calibrated_where_noise_is_constant() -> None:
    noise = ResidualNoise(0.004)
    weight, memory, true = learn(RecursiveLeastSquares(1e4), noise, 1500, 0, spread=False)
    assert chi_square(weight, noise, memory, true, spread=False) == pytest.approx(1, abs=0.06)


@pytest.mark.oracle
def test_linear_noise_is_calibrated_where_noise_grows_with_a_feature() -> None:
    linear, constant = LinearNoise(0.02), ResidualNoise(0.004)
    weight, memory, true = learn(RecursiveLeastSquares(1e4), linear, 2500, 1, spread=True)
    g = torch.Generator().manual_seed(5)
    few, many = [], []
    for _ in range(300):
        phi, y = sample(g, true, spread=True)
        e = y - (weight @ phi.unsqueeze(-1)).squeeze(-1)
        fit = (e * torch.linalg.solve(linear.covariance(memory, phi), e)).sum(-1) / N
        small = phi[:, 0].abs() < 0.5
        few.append(fit[small].mean())
        many.append(fit[phi[:, 0].abs() > 1.2].mean())
    # In calm and in rough places alike; a constant covariance is right in neither.
    assert float(torch.stack(few).mean()) == pytest.approx(1, abs=0.25)
    assert float(torch.stack(many).mean()) == pytest.approx(1, abs=0.25)
    memory = learn(RecursiveLeastSquares(1e4), constant, 1500, 1, spread=True)[1]
    # Where phi is zero the variance is a fifth of ROOT ROOT', which the average cannot know.
    calm = constant.covariance(memory, torch.zeros(40, K).double())
    assert float(calm[:, 0, 0].mean()) > 2 * 0.2 * 0.09


@pytest.mark.oracle
@pytest.mark.parametrize("fit", [RecursiveLeastSquares(1e4), BayesianLeastSquares()])
def test_bayesian_noise_is_calibrated_while_the_model_is_still_poor(fit: Fit) -> None:
    """After eight samples of three features, the noise alone is far too confident."""
    bayesian, aleatoric = BayesianNoise(0.1), ResidualNoise(0.1)
    found = []
    for noise in (bayesian, aleatoric):
        # The noise's own covariance is given; the question is the model's ignorance.
        weight, memory, true = learn(fit, noise, 8, 2, spread=False, batch=400)
        memory = memory | {"nu": (ROOT @ ROOT.T).expand(400, N, N)}
        if isinstance(noise, BayesianNoise):
            # P as of after the last sample.
            again = learn(fit, BayesianNoise(0.0), 9, 2, spread=False, batch=400)[1]
            memory["P"] = again["P"]
        found.append(chi_square(weight, noise, memory, true, spread=False))
    assert found[0] == pytest.approx(1, abs=0.15)
    assert found[1] > 1.3


def test_bayesian_noise_by_hand() -> None:
    noise = BayesianNoise(0.5, stretch=4.0)
    memory = noise.initial(torch.zeros(1, 1, 1).double())
    fit = {"P": f64([[[3.0]]])}
    phi = f64([[2.0]])
    memory = noise.update(memory, f64([[[26.0]]]), phi, fit, ONE)
    # e^2 / (1 + 4 * 3) = 2, half of the way from 0.
    assert float(memory["nu"]) == pytest.approx(1.0)
    assert float(noise.covariance(memory, phi)) == pytest.approx(1 + 4 * 12)


@pytest.mark.parametrize("noise", [ResidualNoise(0.3), LinearNoise(0.5), BayesianNoise(0.3)])
def test_always_positive_semidefinite_and_symmetric(noise: Noise) -> None:
    g = torch.Generator().manual_seed(3)
    memory = noise.initial(torch.zeros(6, 3, 4).double())
    fit = {"P": torch.eye(4).double().expand(6, 4, 4)}
    for _ in range(60):
        e = normal(g, 6, 3) * 10 ** (2 * normal(g, 6, 1))
        memory = noise.update(memory, outer(e), normal(g, 6, 4), fit, ONE)
        nu = noise.covariance(memory, 3 * normal(g, 6, 4))
        values = torch.linalg.eigvalsh(nu)
        assert bool((values[:, 0] >= -1e-12 * values[:, -1]).all())
        assert torch.allclose(nu, nu.mT, rtol=1e-12, atol=0)


def test_residual_noise_is_a_moving_average() -> None:
    rule = ResidualNoise(0.25)
    memory = rule.initial(torch.zeros(1, 2, 1).double())
    squared, phi = outer(f64([[1.0, 2.0]])), f64([[0.0]])
    for k in range(1, 6):
        memory = rule.update(memory, squared, phi, {}, ONE)
        assert torch.allclose(memory["nu"], (1 - 0.75**k) * squared)
    # A rate above one per tick means the last residual, not beyond it.
    assert torch.allclose(ResidualNoise(50.0).update(memory, squared, phi, {}, ONE)["nu"], squared)


def test_refuses_the_impossible() -> None:
    with pytest.raises(ValueError, match="rate=-1"):
        ResidualNoise(-1)
    with pytest.raises(ValueError, match="stretch=0"):
        BayesianNoise(1.0, stretch=0)
