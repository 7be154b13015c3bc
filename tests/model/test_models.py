"""Both forms of the model: targets on the circle, Euler steps, matrices of the closed loop."""

from __future__ import annotations

import math

import pytest
import torch
from torch.func import jacrev

from edtorch.model.features import Affine, Identity, Pairwise
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.types import Transition
from tests.systems import normal

DT = torch.tensor(0.01, dtype=torch.float64)


def make(
    kind: type[DerivativeModel | NextStateModel], *, period: float = 0.0
) -> DerivativeModel | NextStateModel:
    periods = torch.tensor([0.0, period], dtype=torch.float64)
    return kind(2, 1, Identity(3), periods)


def transition(state: list[float], following: list[float]) -> Transition:
    s, after = (torch.tensor([x], dtype=torch.float64) for x in (state, following))
    action = torch.zeros(1, 1, dtype=torch.float64)
    return Transition(s, action, after, DT, torch.ones(1, dtype=torch.bool))


def test_displacement_takes_the_short_way_round() -> None:
    # An angle scaled by pi has the period 2: from .99 to -.98 is .03 forward.
    model = make(DerivativeModel, period=2.0)
    moved = model.displacement(transition([5.0, 0.99], [8.0, -0.98]))
    assert moved[0].tolist() == pytest.approx([3.0, 0.03], abs=1e-12)
    moved = model.displacement(transition([5.0, -0.99], [8.0, 0.98]))
    assert moved[0].tolist() == pytest.approx([3.0, -0.03], abs=1e-12)
    plain = make(DerivativeModel).displacement(transition([0.0, 0.99], [0.0, -0.98]))
    assert plain[0, 1] == pytest.approx(-1.97)


def test_targets_of_the_two_forms() -> None:
    step = transition([1.0, 0.99], [1.5, -0.98])
    rate = DerivativeModel(2, 1, Identity(3), torch.tensor([0.0, 2.0]).double()).target(step)
    assert rate[0].tolist() == pytest.approx([50.0, 3.0], abs=1e-9)
    following = NextStateModel(2, 1, Identity(3), torch.tensor([0.0, 2.0]).double()).target(step)
    assert following[0].tolist() == pytest.approx([1.5, 1.02], abs=1e-12)


@pytest.mark.parametrize("kind", [DerivativeModel, NextStateModel])
def test_linear_dynamics_are_the_jacobians(kind: type[DerivativeModel | NextStateModel]) -> None:
    model = make(kind)
    g = torch.Generator().manual_seed(0)
    weight, s, a = normal(g, 2, 3), normal(g, 2), normal(g, 1)

    def advance(state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(model, {"weight": weight}, (state, action, 0.05))

    dynamics = model.linear_dynamics({"weight": weight}, 0.05)
    assert dynamics is not None
    assert torch.allclose(dynamics.state, jacrev(advance, argnums=0)(s, a), rtol=1e-13)
    assert torch.allclose(dynamics.action, jacrev(advance, argnums=1)(s, a), rtol=1e-13)
    assert torch.allclose(advance(s, a), dynamics.state @ s + dynamics.action @ a, rtol=1e-13)


def test_euler_steps_converge_with_order_one() -> None:
    # ds/dt = w s has the solution exp(w t): halving the step halves the error.
    model = DerivativeModel(1, 1, Identity(2), torch.zeros(1, dtype=torch.float64))
    weight = torch.tensor([[-1.3, 0.0]], dtype=torch.float64)
    errors = []
    for steps in (50, 100, 200):
        s = torch.ones(1, dtype=torch.float64)
        for _ in range(steps):
            s = torch.func.functional_call(model, {"weight": weight}, (s, 0 * s, 1 / steps))
        errors.append(abs(float(s) - math.exp(-1.3)))
    assert [errors[0] / errors[1], errors[1] / errors[2]] == pytest.approx([2, 2], abs=0.05)


def test_noise_per_second_and_per_step() -> None:
    residual = torch.tensor([[2.0, -1.0]], dtype=torch.float64)
    outer = torch.tensor([[[4.0, -2.0], [-2.0, 1.0]]], dtype=torch.float64)
    rate = DerivativeModel(2, 1, Identity(3), torch.zeros(2, dtype=torch.float64))
    # Residuals of the derivative over dt are residuals of the increment over dt squared.
    assert torch.allclose(rate.residual_noise(residual, DT), outer * DT)
    assert torch.allclose(rate.noise_over(outer, 0.05), 0.05 * outer)
    step = NextStateModel(2, 1, Identity(3), torch.zeros(2, dtype=torch.float64))
    assert torch.equal(step.residual_noise(residual, DT), outer)
    assert torch.equal(step.noise_over(outer, 0.05), outer)


def test_no_linear_dynamics_with_other_features() -> None:
    model = DerivativeModel(2, 1, Pairwise(3), torch.zeros(2, dtype=torch.float64))
    assert model.linear_dynamics({"weight": model.weight}, 0.05) is None


@pytest.mark.parametrize("kind", [DerivativeModel, NextStateModel])
def test_affine_dynamics_have_a_constant(kind: type[DerivativeModel | NextStateModel]) -> None:
    model = kind(2, 1, Affine(3), torch.zeros(2, dtype=torch.float64))
    g = torch.Generator().manual_seed(0)
    weight, s, a = normal(g, 2, 4), normal(g, 2), normal(g, 1)
    dynamics = model.linear_dynamics({"weight": weight}, 0.05)
    assert dynamics is not None and dynamics.constant is not None
    found = torch.func.functional_call(model, {"weight": weight}, (s, a, 0.05))
    built = s + dynamics.drift @ s + dynamics.action @ a + dynamics.constant
    assert torch.allclose(found, built, rtol=1e-13)


def test_refuses_features_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match="takes 4 inputs, expected 2 states"):
        DerivativeModel(2, 1, Identity(4), torch.zeros(2))
    with pytest.raises(ValueError, match="period has shape"):
        DerivativeModel(2, 1, Identity(3), torch.zeros(3))
