"""Expected costs under beliefs: finite differences, Monte Carlo, and the costs of roll-outs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.model.mechanism import acceleration_cov, accelerations
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.squash import Squash
from edtorch.search.adam import BELIEFS, adam
from edtorch.search.belief import CompiledTicks, ExpectedCost, ReadLoop, gaussians, points
from edtorch.search.families import (
    MonomialPolicies,
    NetworkPolicies,
    PolicyFamily,
    RadialPolicies,
)
from edtorch.search.imagination import Futures, imagine_policies
from edtorch.search.plan import ramp
from edtorch.search.policy_descent import Weighted, expansion
from edtorch.search.ticks import drawn_ticks
from edtorch.transform import MeanOnly, Transform
from edtorch.types import Parameters
from tests.planning import HANGING, swing_up, swing_up_cost
from tests.systems import normal

MODEL = swing_up()
LIFT = MODEL.structure.lift
SQUASH = Squash(torch.zeros(1).double(), torch.ones(1).double())
READING = torch.tensor([0.01, 0.02, 0.01, 0.02], dtype=torch.float64)
FAMILIES = (MonomialPolicies(2), RadialPolicies(8), NetworkPolicies((6,)))
TICKS = 6


def _cov(size: float) -> Tensor:
    """Of the weights: independent, in proportion to those that are not zero."""
    return torch.diag_embed(torch.from_numpy((size * MODEL.weight) ** 2))


def _starts(spread: float, count: int = 50) -> Tensor:
    return torch.from_numpy(HANGING) + spread * normal(torch.Generator().manual_seed(0), count, 4)


def _expected(family: PolicyFamily, transform: Transform) -> tuple[ExpectedCost, Parameters]:
    policy = family.policy(LIFT, range(4), SQUASH, odd=False)
    cost = replace(swing_up_cost(MODEL, TICKS, power=1.0), squash=0.02)
    starts = gaussians(_starts(0.1), MODEL.structure.period, 2)
    expected = ExpectedCost(MODEL, policy, cost, transform, starts, _cov(0.02), READING)
    return expected, policy.random(2, 0.1, np.random.default_rng(0))


@pytest.mark.parametrize("belief", BELIEFS)
@pytest.mark.parametrize("family", FAMILIES, ids=lambda f: type(f).__name__)
def test_gradients_are_finite_differences(family: PolicyFamily, belief: str) -> None:
    expected, parameters = _expected(family, BELIEFS[belief])
    own = {name: p.clone().requires_grad_() for name, p in parameters.items()}
    expected(own).sum().backward()
    slopes = {name: p.grad for name, p in own.items() if p.grad is not None}
    assert slopes.keys() == own.keys()
    generator, step = torch.Generator().manual_seed(1), 1e-5
    along = {name: normal(generator, *p.shape) for name, p in parameters.items()}
    ahead, behind = (
        expected({name: p + h * along[name] for name, p in parameters.items()})
        for h in (step, -step)
    )
    slope = torch.stack([(along[name] * p).flatten(1).sum(1) for name, p in slopes.items()]).sum(0)
    assert torch.allclose((ahead - behind).detach() / (2 * step), slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("belief", BELIEFS)
def test_mean_and_covariance_are_those_of_many_courses(belief: str) -> None:
    """Starts, readings and accelerations drawn anew at each tick; small enough for first order."""
    expected, parameters = _expected(NetworkPolicies((6,)), BELIEFS[belief])
    near = gaussians(_starts(0.01), MODEL.structure.period, 1)
    expected = replace(expected, starts=near, cov=_cov(0.01), reading=0.5 * READING)
    found, size = expected.beliefs(parameters), 10000
    generator, draws = torch.Generator().manual_seed(2), np.random.default_rng(3)
    root = torch.linalg.cholesky(near.cov[0])
    state = (near.mean + normal(generator, size, 4) @ root.mT).unsqueeze(1).expand(-1, 2, -1)
    for _ in range(TICKS):
        error = 0.5 * READING * normal(generator, *state.shape)
        action = expected.policy.action(parameters, state + error)
        weight = MODEL.weight * (1 + 0.01 * draws.standard_normal((size, *MODEL.weight.shape)))
        state = drawn_ticks(MODEL, weight, state, action)
    for b in range(2):
        mean, cov = found.mean[-1, 0, b, :4], found.cov[-1, 0, b, :4, :4]
        deviation = cov.diagonal().sqrt()
        assert ((state[:, b].mean(0) - mean).abs() < 0.05 * deviation).all()
        drawn = torch.cov(state[:, b].mT)
        scale = deviation.unsqueeze(-1) * deviation
        assert torch.allclose(drawn / scale, cov / scale, atol=0.05)


def test_what_is_unknown_of_accelerations_is_that_of_drawn_weights() -> None:
    structure, weight = MODEL.structure, torch.from_numpy(MODEL.weight)
    generator = torch.Generator().manual_seed(0)
    state, action = normal(generator, 1, 4), normal(generator, 1, 1)
    found = acceleration_cov(structure, weight, _cov(0.01), state, action)[0]
    drawn = weight * (1 + 0.01 * normal(generator, 5000, *weight.shape))
    rows = accelerations(structure, drawn, state.expand(5000, -1), action.expand(5000, -1))
    scale = found.diagonal().sqrt()
    assert torch.allclose(
        torch.cov(rows.mT) / scale.outer(scale), found / scale.outer(scale), atol=0.06
    )


def test_first_order_of_compiled_ticks_is_that_of_automatic_derivatives() -> None:
    """The closed loop's Jacobian beside finite differences of the loop."""
    expected, parameters = _expected(RadialPolicies(8), MeanOnly())
    loop = ReadLoop(CompiledTicks(MODEL), expected.policy, parameters)
    z = 0.3 * normal(torch.Generator().manual_seed(4), 3, 2, 8)
    step = 1e-6 * torch.eye(8, dtype=torch.float64)
    found = loop.jacobian(z)
    for k in range(8):
        slope = (loop(z + step[k]) - loop(z - step[k])) / 2e-6
        assert torch.allclose(found[..., k], slope, atol=1e-7)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda f: type(f).__name__)
def test_without_a_belief_it_is_the_mean_cost_of_roll_outs(family: PolicyFamily) -> None:
    """As imagined without noise, and for monomials as compiled."""
    expected, parameters = _expected(family, MeanOnly())
    starts = _starts(0.2, 3)
    expected = replace(expected, starts=points(starts))
    value = expected(parameters)
    futures = Futures(np.tile(MODEL.weight, (3, 1, 1)), starts.numpy(), np.zeros((3, TICKS, 4)))
    found = imagine_policies(MODEL, expected.cost, expected.policy, parameters, futures)
    assert [each.cost.mean() for each in found] == pytest.approx(value.tolist(), rel=1e-10)
    terms = expected.policy.linear_terms
    if terms is not None:
        for weight, mean in zip(parameters["weight"].numpy(), value.tolist(), strict=True):
            compiled, *_ = expansion(MODEL, expected.cost, Weighted(terms, weight), starts.numpy())
            assert compiled == pytest.approx(mean, rel=1e-9)


def test_gaussians_have_the_moments_of_their_starts() -> None:
    """Two clusters across the seam of an angle."""
    period = torch.tensor([0.0, 2 * np.pi]).double()
    generator = torch.Generator().manual_seed(0)
    one = torch.tensor([0.0, np.pi]).double() + 0.1 * normal(generator, 30, 2)
    other = torch.tensor([5.0, 0.0]).double() + 0.1 * normal(generator, 10, 2)
    turns = torch.tensor([0.0, 1.0]) * torch.randint(-1, 2, (30, 1), generator=generator)
    found = gaussians(torch.cat([one + 2 * np.pi * turns, other]), period, 2)
    assert found.share.tolist() == [0.75, 0.25]
    moments = [(each.mean(0), torch.cov(each.mT, correction=0)) for each in (one, other)]
    for g, (mean, cov) in enumerate(moments):
        away = torch.remainder(found.mean[g] - mean + np.pi, 2 * np.pi) - np.pi
        assert torch.allclose(away, torch.zeros(2).double(), atol=1e-12)
        assert torch.allclose(found.cov[g], cov, atol=1e-12)
    assert len(gaussians(one[:1].expand(5, 2), period, 3).mean) == 1


def _wild(policy: BoundedPolicy) -> Parameters:
    drawn = policy.random(3, 0.2, np.random.default_rng(0))
    drawn["weight"][1] = torch.nan
    return drawn


def test_adam_improves_each_policy_by_itself() -> None:
    """The same alone and beside one that is not finite."""
    expected, _ = _expected(RadialPolicies(8), MeanOnly())
    expected = replace(expected, cost=replace(expected.cost, weight=ramp(TICKS, 1.0)))
    fresh = _wild(expected.policy)
    found = adam(expected, fresh, 8, 0.1)
    alone = adam(expected, {name: p[2:] for name, p in fresh.items()}, 8, 0.1)
    before = expected(fresh).detach().numpy()
    assert np.isinf(found.cost[1]) and len(found.finite.cost) == 2
    assert (found.cost[[0, 2]] < before[[0, 2]]).all()
    assert found.cost[2] == pytest.approx(alone.cost[0], rel=1e-9)
    again = expected(found.finite.parameters).detach().numpy()
    assert again == pytest.approx(found.finite.cost, rel=1e-12)
