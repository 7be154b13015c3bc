"""The regulator about the model's equilibrium, against closed forms and simulation."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.features import Affine, Identity
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.policy.policies import LinearPolicy
from edtorch.types import Parameters
from edtorch.value.linear.equilibrium import (
    EquilibriumRegulator,
    HoldSettings,
    equilibrium,
    summed,
)
from edtorch.value.linear.lqr import stationary_lqr

DT = 0.1
NONE = torch.zeros(2, dtype=torch.float64)
CENTRE = torch.tensor([[0.5, 0.0]]).double()
EXCURSION = torch.tensor([[2.0, 4.0]]).double()


def _mass(push: float = -3.0) -> tuple[Tensor, Tensor, Tensor]:
    """A mass of 2 kg under a constant force: ds/dt of (position, speed), its D, G, c per tick."""
    weight = torch.tensor([[0.0, 0.0, 1.0, 0.0], [push / 2, 0.0, 0.0, 0.5]]).double()
    return weight, DT * weight[:, 1:3], DT * weight[:, 3:]


def _regulator(**settings: float) -> EquilibriumRegulator:
    model = DerivativeModel(2, 1, Affine(3), NONE)
    policy = LinearPolicy(2, 1, Affine(2))
    middle, half = torch.zeros(1).double(), torch.full((1,), 10.0).double()
    hold = HoldSettings(**settings)  # pyright: ignore[reportArgumentType]
    return EquilibriumRegulator(
        model, policy, DT, {0: 0.5}, {}, torch.ones(1).double(), middle, half, hold
    )


def _model(weight: Tensor) -> Parameters:
    return {
        "weight": weight.unsqueeze(0),
        "centre": CENTRE,
        "excursion": EXCURSION,
        "spread": EXCURSION,
        "error": torch.zeros_like(CENTRE),
        "count": torch.full((1,), 100.0).double(),
    }


def _policy(constant: float, position: float, speed: float) -> Parameters:
    return {"weight": torch.tensor([[[constant, position, speed]]]).double()}


def test_a_constant_force_is_held_by_the_opposite_action() -> None:
    weight, drift, G = _mass()
    held = torch.tensor([True, False])
    where, action = equilibrium(
        drift[None],
        G[None],
        DT * weight[:, 0][None],
        CENTRE,
        EXCURSION,
        held,
        torch.zeros(1).double(),
        torch.full((1,), 10.0).double(),
        1e-6,
    )
    assert where[0].tolist() == pytest.approx([0.5, 0.0], abs=1e-6)
    assert action[0].tolist() == pytest.approx([3.0], abs=1e-6)


def test_an_action_beyond_its_bounds_is_clamped() -> None:
    weight, drift, G = _mass(push=-30.0)
    parts = (drift[None], G[None], DT * weight[:, 0][None], CENTRE, EXCURSION)
    half = torch.full((1,), 10.0).double()
    _, action = equilibrium(*parts, torch.tensor([True, False]), 0 * half, half, 1e-6)
    assert action.item() == 10.0


@pytest.mark.parametrize("error", [0.0, 0.5, 2.0])
def test_the_closed_loop_has_the_margin_of_the_models_standard_error(error: float) -> None:
    """The spectral radius is at most 1 / (1 + d); the largest margin is 0.1 per tick."""
    weight, drift, G = _mass()
    model = _model(weight) | {"error": torch.full_like(CENTRE, error)}
    found = _regulator()(model, _policy(0.0, 0.0, 0.0), {}, CENTRE)
    K = found.gradient["weight"][0, :, 1:]
    radius = float(torch.linalg.eigvals(torch.eye(2) + drift + G @ K).abs().max())
    relative = ((DT * error / EXCURSION[0]).square().mean() * 4 / 100).sqrt()
    assert radius <= 1 / (1 + min(2 * float(relative), 0.1)) + 1e-9
    plain = _regulator(margin=0.0)(model, _policy(0.0, 0.0, 0.0), {}, CENTRE)
    same = bool(torch.allclose(plain.gradient["weight"], found.gradient["weight"], rtol=1e-12))
    assert same == (error == 0.0)


def test_what_no_action_moves_asks_for_no_margin() -> None:
    """A constant beside a controlled component: the gain is that without a margin."""
    weight = torch.tensor([[0.0, 0.3, 0.2, 1.0], [0.0, 0.0, 0.0, 0.0]]).double()
    model = _model(weight) | {"error": torch.full_like(CENTRE, 1.0)}
    careful = _regulator()(model, _policy(0.0, 0.0, 0.0), {}, CENTRE)
    plain = _regulator(margin=0.0)(model, _policy(0.0, 0.0, 0.0), {}, CENTRE)
    assert plain.gradient["weight"].abs().max() > 0.1
    torch.testing.assert_close(careful.gradient, plain.gradient, rtol=1e-12, atol=0.0)


def test_the_rest_changes_least_where_many_equilibria_exist() -> None:
    """s1 + s2 + a = 1 leaves a plane of equilibria: the nearest one to (centre, middle) is
    taken."""
    drift = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]]]).double()
    G = torch.tensor([[[0.0], [1.0], [0.0]]]).double()
    constant = torch.tensor([[0.0, -1.0, 0.0]]).double()
    centre, one = torch.zeros(1, 3).double(), torch.ones(1).double()
    held = torch.tensor([True, False, False])
    where, action = equilibrium(
        drift, G, constant, centre, torch.ones(1, 3).double(), held, 0 * one, 10 * one, 1e-4
    )
    # Minimise s1^2 + s2^2 + (a / 10)^2 with s1 + s2 + a = 1: (s1, s2, a) ~ (1, 1, 100).
    expected = [0.0, 1 / 102, 1 / 102]
    assert where[0].tolist() == pytest.approx(expected, abs=1e-5)
    assert action.item() == pytest.approx(100 / 102, abs=1e-5)


def test_the_regulator_is_riccatis_about_the_equilibrium() -> None:
    weight, drift, G = _mass()
    rule = _regulator(rest=0.25, price=2.0, slack=1e-6)
    policy = _policy(0.0, 0.0, 0.0)
    found = rule(_model(weight), policy, {}, NONE[None])
    new = policy["weight"] + found.gradient["weight"]
    Q = torch.diag(torch.tensor([1.0, 0.25]).double() / EXCURSION[0].square())
    R = torch.full((1, 1), 2.0 / 100).double()
    K, P = stationary_lqr(torch.eye(2).double() + drift, G, Q, R)
    torch.testing.assert_close(new[0, :, 1:], K, rtol=1e-8, atol=1e-8)
    # It holds the target: at s_eq it gives the action that balances the force.
    at_target = new[0, 0, 0] + new[0, 0, 1] * 0.5
    assert at_target.item() == pytest.approx(3.0, abs=1e-5)
    # The horizon is long: the cost is that of the stationary regulator.
    assert found.value.item() == pytest.approx(
        -(P.diagonal() * EXCURSION[0].square()).sum().item(), rel=1e-6
    )


def test_both_forms_of_the_model_give_the_same_policy() -> None:
    weight, _, _ = _mass()
    step = DT * weight
    step[:, 1:3] += torch.eye(2).double()
    derivative = _regulator()
    model = NextStateModel(2, 1, Affine(3), NONE)
    following = EquilibriumRegulator(
        model,
        derivative.policy,
        DT,
        {0: 0.5},
        {},
        derivative.prices,
        derivative.middle,
        derivative.half,
    )
    policy = _policy(0.0, 0.0, 0.0)
    one = derivative(_model(weight), policy, {}, NONE[None])
    other = following(_model(step), policy, {}, NONE[None])
    torch.testing.assert_close(one.gradient["weight"], other.gradient["weight"])


def test_the_cost_of_a_policy_is_that_of_its_rides() -> None:
    weight, drift, G = _mass()
    doublings = 4
    rule = _regulator(doublings=doublings, gain=0.9999)  # nothing saves that much: the policy stays
    policy = _policy(1.0, -4.0, -5.0)
    found = rule(_model(weight), policy, {}, NONE[None])
    assert not bool(found.gradient["weight"].any())
    where, action = torch.tensor([0.5, 0.0]).double(), torch.tensor([3.0]).double()
    Q = torch.diag(torch.tensor([1.0, 0.01]).double() / EXCURSION[0].square())
    total = 0.0
    # Four starts whose mean and covariance are those of the excursions about the equilibrium.
    for sign in (-1, 1):
        for i in range(2):
            s = where.clone()
            s[i] += sign * math.sqrt(2) * EXCURSION[0, i]
            for _ in range(2**doublings):
                a = policy["weight"][0, :, 0] + policy["weight"][0, :, 1:] @ s
                away, push = s - where, a - action
                total += float(away @ Q @ away + push @ push / 100) / 4
                s = s + drift @ s + G @ a + DT * weight[:, 0]
    assert -found.value.item() == pytest.approx(total, rel=1e-4)


def test_a_policy_that_gains_nothing_stays() -> None:
    weight, _, _ = _mass()
    rule, policy = _regulator(), _policy(0.0, 0.0, 0.0)
    first = rule(_model(weight), policy, {}, NONE[None]).gradient["weight"]
    best = {"weight": policy["weight"] + first}
    assert not bool(rule(_model(weight), best, {}, NONE[None]).gradient["weight"].any())


def test_a_model_that_cannot_be_stabilised_keeps_the_policy() -> None:
    weight = torch.tensor([[0.0, 90.0, 0.0, 0.0], [0.0, 0.0, 90.0, 0.0]]).double()
    found = _regulator()(_model(weight), _policy(1.0, 2.0, 3.0), {}, NONE[None])
    assert not bool(found.gradient["weight"].any()) and bool(found.value.isfinite())


def test_sums_of_powers() -> None:
    g = torch.Generator().manual_seed(0)
    A = 0.4 * torch.randn(3, 3, 3, generator=g, dtype=torch.float64)
    cost = torch.eye(3).double().expand(3, 3, 3)
    power, expected = cost, torch.zeros_like(cost)
    for _ in range(8):
        expected = expected + power.mT @ power
        power = power @ A
    torch.testing.assert_close(summed(A, cost, 3), expected)


@pytest.mark.parametrize(
    ("name", "value"),
    [("price", 0.0), ("slack", 0.0), ("rest", 1.5), ("gain", 1.0), ("doublings", 0)],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name}={value}: expected"):
        HoldSettings(**{name: value})  # pyright: ignore[reportArgumentType]


def test_parts_without_a_constant_are_refused() -> None:
    one, affine = torch.ones(1).double(), LinearPolicy(2, 1, Affine(2))
    plain = DerivativeModel(2, 1, Identity(3), NONE)
    with pytest.raises(ValueError, match=r"expected a model that is linear with a constant"):
        EquilibriumRegulator(plain, affine, DT, {}, {}, one, 0 * one, one)
    model = DerivativeModel(2, 1, Affine(3), NONE)
    with pytest.raises(ValueError, match=r"expected a policy that is linear with a constant"):
        EquilibriumRegulator(model, LinearPolicy(2, 1, Identity(2)), DT, {}, {}, one, 0 * one, one)


def test_every_learner_has_its_own_equilibrium() -> None:
    weight, drift, G = _mass()
    constant = torch.stack([DT * weight[:, 0], -DT * weight[:, 0]])
    held = torch.tensor([True, False])
    half = torch.full((1,), 10.0).double()
    where, action = equilibrium(
        drift.expand(2, 2, 2),
        G.expand(2, 2, 1),
        constant,
        CENTRE.expand(2, 2),
        EXCURSION.expand(2, 2),
        held,
        0 * half,
        half,
        1e-6,
    )
    left = matvec(drift.expand(2, 2, 2), where) + matvec(G.expand(2, 2, 1), action) + constant
    assert left.abs().max() < 1e-5
    assert action.flatten().tolist() == pytest.approx([3.0, -3.0], abs=1e-5)
