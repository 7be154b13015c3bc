"""Riccati's direction against the regulator found with a library's solver."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from edtorch.linalg import solve_positive
from edtorch.model.features import Affine, Identity
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import FullStep
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder
from edtorch.value.choose import choose_path
from edtorch.value.linear.lqr import finite_horizon_lqr
from edtorch.value.linear.regulator import Regulator, first_gain
from edtorch.value.unroll import Horizon
from tests.systems import normal, random_cost

N, M = 5, 2
HORIZON = Horizon(12, 0.05, 0.9, 0.05)


def problem() -> tuple[Regulator, dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    g = torch.Generator().manual_seed(7)
    model = DerivativeModel(N, M, Identity(N + M), torch.zeros(N, dtype=torch.float64))
    reward = QuadraticReward(random_cost(g, N), random_cost(g, M))
    start = random_cost(g, N)
    regulator = Regulator(model, LinearPolicy(N, M, Identity(N)), reward, HORIZON, start)
    return regulator, {"weight": normal(g, 4, N, N + M)}, {"weight": normal(g, 4, M, N)}


def test_solves_positive_systems() -> None:
    g = torch.Generator().manual_seed(0)
    for m in (1, 2, 5):
        root = normal(g, 3, m, m)
        A, Y = root @ root.mT + 0.1 * torch.eye(m), normal(g, 3, m, 4)
        assert torch.allclose(solve_positive(A, Y), torch.linalg.solve(A, Y), rtol=1e-9)


def test_leads_to_the_first_gain_of_the_regulator() -> None:
    regulator, model, policy = problem()
    found = regulator(model, policy, {}, torch.zeros(4, N, dtype=torch.float64))
    there, _ = FullStep()(policy, found.gradient, {}, torch.tensor(0.01))
    F = torch.eye(N) + HORIZON.dt * model["weight"][..., :N]
    G = HORIZON.dt * model["weight"][..., N:]
    # One step is weighed by its seconds, all costs alike: the gain does not notice.
    Q, R = regulator.form.state, regulator.form.action
    wanted = finite_horizon_lqr(F, G, Q, R, steps=HORIZON.steps, discount=0.9**0.05)
    assert torch.allclose(there["weight"], wanted.gains[0], rtol=1e-9, atol=1e-12)
    _, P = first_gain(HORIZON.dt * model["weight"][..., :N], G, Q, R, HORIZON)
    assert torch.allclose(P, HORIZON.unit * wanted.cost, rtol=1e-9)
    again = regulator(model, there, {}, torch.zeros(4, N, dtype=torch.float64))
    assert float(again.gradient["weight"].abs().max()) < 1e-12


def test_constants_and_targets_shift_the_same_regulator() -> None:
    # A target that is an equilibrium without action: in s - target the loop is the linear one.
    plain, model, _ = problem()
    g = torch.Generator().manual_seed(8)
    target = normal(g, N)
    zero = torch.zeros(N, dtype=torch.float64)
    affine = DerivativeModel(N, M, Affine(N + M), zero)
    reward = QuadraticReward(plain.form.state, plain.form.action, target=target)
    shifted = Regulator(affine, LinearPolicy(N, M, Affine(N)), reward, HORIZON, plain.start_cov)
    constant = -(model["weight"][..., :N] @ target).unsqueeze(-1)
    weight = {"weight": torch.cat([constant, model["weight"]], dim=-1)}
    nothing = {"weight": torch.zeros(4, M, 1 + N, dtype=torch.float64)}
    away = normal(g, 4, N)
    found = shifted(weight, nothing, {}, target + away)
    zeros = {"weight": torch.zeros(4, M, N, dtype=torch.float64)}
    wanted = plain(model, zeros, {}, away)
    gain = wanted.gradient["weight"]
    assert torch.allclose(found.value, wanted.value, rtol=1e-9)
    assert torch.allclose(found.gradient["weight"][..., 1:], gain, rtol=1e-9, atol=1e-12)
    offset = -(gain @ target)
    assert torch.allclose(found.gradient["weight"][..., 0], offset, rtol=1e-9, atol=1e-12)


def test_the_gradient_vanishes_there() -> None:
    # One step ahead there is one gain only: the top of what the gradient climbs, but for the cost
    # of the last action, which moves nothing that counts and which the regulator leaves out.
    regulator, model, policy = problem()
    one = replace(regulator, horizon=Horizon(1, 0.05, 1.0, 0.05))
    state = torch.zeros(4, N, dtype=torch.float64)
    direction = one(model, policy, {}, state).gradient
    there, _ = FullStep()(policy, direction, {}, torch.tensor(1.0))
    choice = choose_path(
        "generic",
        one.model,
        one.policy,
        one.reward,
        FirstOrder(),
        Horizon(1, 0.05, 1.0, 0.05, "definition"),
        noise=ResidualNoise(1.0),
        start_cov=one.start_cov,
    )
    quiet = {"nu": torch.zeros(4, N, N, dtype=torch.float64)}
    found = choice.path(model, there, quiet, state).gradient["weight"]
    theta = there["weight"].clone().requires_grad_()
    drift, G = (0.05 * part for part in model["weight"].split([N, M], dim=-1))
    A = torch.eye(N) + drift + G @ theta
    end = A @ one.start_cov @ A.mT
    last = 0.05 * (theta.mT @ one.form.action @ theta * end).sum()
    (own,) = torch.autograd.grad(-last, theta)
    assert torch.allclose(found, own, atol=1e-12)


def test_refuses_actions_that_cost_nothing_and_constants_out_of_reach() -> None:
    regulator, _, _ = problem()
    free = QuadraticReward(regulator.form.state, torch.zeros(M, M, dtype=torch.float64))
    with pytest.raises(ValueError, match="expected a cost > 0 of every action"):
        Regulator(regulator.model, regulator.policy, free, HORIZON, regulator.start_cov)
    model = DerivativeModel(N, M, Affine(N + M), torch.zeros(N, dtype=torch.float64))
    with pytest.raises(ValueError, match="expected a policy with a constant"):
        Regulator(model, regulator.policy, regulator.reward, HORIZON, regulator.start_cov)
