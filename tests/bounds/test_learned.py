"""Errors of a learned model, and constants of the balls that bounded noise cannot leave."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from edtorch.bounds import (
    GAUSSIAN,
    NO_MODEL_ERROR,
    Constants,
    ErrorBounds,
    ModelError,
    NoiseLaw,
    StartLaw,
    bound_errors,
    definition_weights,
    first_order_path,
    tube_radii,
)
from edtorch.rewards import QuadraticReward, Reward
from edtorch.transform import point_belief
from edtorch.types import Belief
from tests.bounds.systems import (
    FLOOR,
    RADEMACHER,
    Law,
    SmoothSystem,
    at_start,
    broken,
    exact_errors,
    exact_laws,
    exact_value_error,
    smooth_system,
)
from tests.systems import f64, normal, random_cost


@dataclass(frozen=True)
class Truth(SmoothSystem):
    """A system at most eta and eta_nu away from the learned one that it is made of."""

    eta: float = 0.0
    eta_nu: float = 0.0
    constant: bool = False

    def mu(self, s: Tensor) -> Tensor:
        shape = torch.ones_like(s) / math.sqrt(self.n)
        wave = 1.0 if self.constant else torch.sin(3 * s.sum(-1, keepdim=True))
        return super().mu(s) + self.eta * wave * shape

    def variances(self, s: Tensor) -> Tensor:
        wave = 1.0 if self.constant else torch.cos(2 * s.sum(-1, keepdim=True))
        return super().variances(s) + self.eta_nu * wave / math.sqrt(self.n)


@pytest.mark.parametrize("n, steps", [(1, 9), (2, 5), (5, 3)])
@pytest.mark.parametrize("constant", [True, False])
def test_learned_models(n: int, steps: int, constant: bool) -> None:
    # Path and constants are the learned model's; the process is the truth's.
    violated_without = 0
    for seed in range(6):
        learned = smooth_system(n, seed, v0=0.05)
        eta, eta_nu = 0.1, 0.4 * learned.v0.min().item()
        truth = Truth(**learned.__dict__, eta=eta, eta_nu=eta_nu, constant=constant)
        states = 3 * normal(torch.Generator().manual_seed(seed), 500, n)
        gap = torch.linalg.vector_norm(truth.mu(states) - learned.mu(states), dim=-1)
        assert gap.max().item() <= eta * (1 + FLOOR)
        gap = torch.linalg.matrix_norm(truth.nu(states) - learned.nu(states))
        assert gap.max().item() <= eta_nu * (1 + FLOOR)

        path, weights = learned.path(steps), definition_weights(0.95, steps)
        laws = exact_laws(truth, RADEMACHER, steps, at_start(learned))
        errors = exact_errors(truth, path, laws)
        constants = learned.constants()
        for error in (ModelError(eta, eta_nu, "analytic"), NO_MODEL_ERROR):
            bounds = bound_errors(
                path, constants, noise_law=NoiseLaw(1.0), weights=weights, model_error=error
            )
            if error is NO_MODEL_ERROR:
                violated_without += len(broken(bounds, errors))
            else:
                assert broken(bounds, errors) == []
                value = exact_value_error(truth, path, laws, weights)
                assert value <= bounds.value_summed and value <= bounds.value_adjoint
    assert violated_without > 0


def test_the_terms_of_a_model_error_are_attained() -> None:
    # Learned s+ = L s + w; in truth mu(+-1) = +-(L + eta), and nu is larger by eta_nu.  The start
    # is +-1, the noise +-sqrt nu: every error and moment of the next step is a bound's value.
    L, eta, nu, eta_nu = 0.9, 0.2, 0.3, 0.05
    path = first_order_path(
        Belief(f64([0.0]), f64([[1.0]])),
        lambda s: L * s,
        lambda s: torch.full((*s.shape, 1), nu, dtype=torch.float64),
        torch.zeros_like,
        reward=QuadraticReward(f64([[1.0]]), f64([[0.0]])),
        steps=1,
    )
    bounds = bound_errors(
        path,
        Constants(L, 0.0, 0.0, 0.0, "analytic"),
        noise_law=NoiseLaw(1.0),
        weights=[1.0, 1.0],
        start=StartLaw(0.0, 0.0, 1.0, 1.0),
        model_error=ModelError(eta, eta_nu, "analytic"),
    )
    push, spread = L + eta, math.sqrt(nu + eta_nu)
    law = Law(
        f64([[push + spread], [push - spread], [-push + spread], [-push - spread]]), f64([0.25] * 4)
    )
    _, cov = law.moments()
    assert bounds.cov[1] == pytest.approx(cov.item() - path.cov[1].item(), rel=1e-13)
    zero = f64([0.0])
    assert bounds.fourth_moment[1] == pytest.approx(law.distance_moment(zero, 4), rel=1e-13)
    # D_2 is the smaller of two forms, one of which knows the bias eta that this truth has not.
    assert bounds.second_moment[1] == pytest.approx(law.distance_moment(zero, 2), rel=1e-13)
    assert bounds.mean[1] == eta


@pytest.mark.parametrize("n, steps, share", [(1, 8, 1.05), (2, 6, 1.1)])
def test_a_tube_with_local_constants_holds_and_is_tighter(n: int, steps: int, share: float) -> None:
    # Rademacher noise is bounded, so that suprema over balls around the means suffice.
    tighter = []
    for seed in range(8):
        system = smooth_system(n, seed, v0=1e-4)
        path, law = system.path(steps), NoiseLaw(1.0)
        radii = tube_radii(
            path.mean,
            lambda center, size, near=system.constants_near: near(center, size).lipschitz,
            noise_radius=math.sqrt(1.5 * system.v0.sum().item()),
        )
        laws = exact_laws(system, RADEMACHER, steps, at_start(system))
        for states, center, size in zip(laws, path.mean, radii, strict=True):
            distance = torch.linalg.vector_norm(states.states - center, dim=-1)
            assert distance.max().item() <= size + FLOOR
        near = [system.constants_near(s, size) for s, size in zip(path.mean, radii, strict=True)]
        weights = definition_weights(0.95, steps)
        bounds = bound_errors(path, near, noise_law=law, weights=weights)
        assert bounds.standing == "certified"
        assert broken(bounds, exact_errors(system, path, laws)) == []
        everywhere = bound_errors(path, system.constants(), noise_law=law, weights=weights)
        assert bounds.value <= everywhere.value * (1 + FLOOR)
        tighter.append(everywhere.mean[-1] / bounds.mean[-1])
    assert statistics.median(tighter) > share


@pytest.mark.parametrize("n", [1, 2])
def test_the_adjoint_form_keeps_directions(n: int) -> None:
    # Linear dynamics whose mean is off by eta at every step, a linear reward; then dynamics whose
    # noise is off by eta_nu, a quadratic reward.  The adjoints are sums of powers of J.
    steps, discount, eta = 5, 0.9, 0.1
    g = torch.Generator().manual_seed(n)
    J, q, Q = normal(g, n, n).abs(), normal(g, n).abs(), random_cost(g, n)

    def bounds_for(reward: Reward, error: ModelError) -> ErrorBounds:
        path = first_order_path(
            point_belief(normal(g, n)),
            lambda s: s @ J.T,
            lambda s: torch.eye(n, dtype=torch.float64).expand(*s.shape, n),
            torch.zeros_like,
            reward=reward,
            steps=steps,
        )
        L = torch.linalg.matrix_norm(J, ord=2).item()
        return bound_errors(
            path,
            Constants(L, 0.0, 0.0, 0.0, "analytic"),
            noise_law=GAUSSIAN,
            weights=definition_weights(discount, steps),
            model_error=error,
        )

    def linear(state: Tensor, action: Tensor) -> Tensor:
        return state @ q

    def powers_after(t: int) -> list[Tensor]:
        """gamma^tau J^(tau - t - 1), tau = t + 1 .. T: how an error made at step t acts."""
        later = range(t + 1, steps + 1)
        return [discount**tau * torch.linalg.matrix_power(J, tau - t - 1) for tau in later]

    vectors = [sum((P.T @ q for P in powers_after(t)), torch.zeros_like(q)) for t in range(steps)]
    exact = eta * sum(torch.linalg.vector_norm(v).item() for v in vectors)
    bounds = bounds_for(linear, ModelError(eta, 0.0, "analytic"))
    assert bounds.value_adjoint == pytest.approx(exact, rel=1e-12)
    assert bounds.value_adjoint <= bounds.value_summed * (1 + FLOOR)

    def pulled(t: int, tau: int) -> Tensor:
        power = torch.linalg.matrix_power(J, tau - t - 1)
        return discount**tau * power.T @ Q @ power

    matrices = [
        sum((pulled(t, tau) for tau in range(t + 1, steps + 1)), torch.zeros_like(Q))
        for t in range(steps)
    ]
    exact = eta * sum(torch.linalg.matrix_norm(m).item() for m in matrices)
    quadratic = QuadraticReward(Q, torch.zeros(n, n, dtype=torch.float64))
    bounds = bounds_for(quadratic, ModelError(0.0, eta, "analytic"))
    assert bounds.value_adjoint == pytest.approx(exact, rel=1e-12)
    if n == 1:
        # All errors have one direction, and add up to exactly this in a truth with nu + eta.
        assert bounds.value_summed == pytest.approx(exact, rel=1e-12)
