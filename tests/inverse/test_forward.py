"""The fast path of a forward model against the generic one."""

from __future__ import annotations

import pytest
import torch

from edtorch.inverse.forward import Errors, Mechanical, distance_cost, tracking
from edtorch.model.models import DerivativeModel
from edtorch.policy.policies import LinearPolicy, SquashedPolicy
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder, MeanOnly
from edtorch.value.unroll import Generic, Horizon
from tests.inverse.arm import Masses

SPEC = Masses().spec
N, M = len(SPEC.state), len(SPEC.action)
HORIZON = Horizon(12, 0.05, 0.8, 0.05)


def _normal(*shape: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 0.2 * torch.randn(*shape, generator=generator, dtype=torch.float64)


def _model() -> DerivativeModel:
    return DerivativeModel(N, M, Mechanical(SPEC), torch.zeros(N, dtype=torch.float64))


def _reward(weight: float) -> QuadraticReward:
    nothing = torch.zeros(M, M, dtype=torch.float64)
    return QuadraticReward(weight * distance_cost(SPEC), nothing)


@pytest.mark.parametrize("kind", [LinearPolicy, SquashedPolicy])
def test_value_and_gradient_are_those_of_the_generic_path(kind: type[LinearPolicy]) -> None:
    model, policy = _model(), kind(N, M, Errors(SPEC))
    fast = tracking(model, policy, _reward(1.7), MeanOnly(), HORIZON)
    assert fast is not None
    generic = Generic(model, policy, _reward(1.7), MeanOnly(), HORIZON)
    weights = _normal(3, N, model.features.outputs, seed=0)
    weights[:, [k for k, q in enumerate(SPEC.state) if q.name in SPEC.goal]] = 0
    parameters = {"weight": _normal(3, M, policy.features.outputs, seed=1)}
    state = _normal(3, N, seed=2)
    found = fast({"weight": weights}, parameters, {}, state)
    expected = generic({"weight": weights}, parameters, {}, state)
    torch.testing.assert_close(found.value, expected.value, rtol=1e-10, atol=0)
    scale = float(expected.gradient["weight"].abs().max())
    torch.testing.assert_close(
        found.gradient["weight"], expected.gradient["weight"], rtol=0, atol=1e-10 * scale
    )


def test_the_fast_path_is_for_what_it_holds_for() -> None:
    model, policy = _model(), SquashedPolicy(N, M, Errors(SPEC))
    assert tracking(model, policy, _reward(1.0), FirstOrder(), HORIZON) is None
    definition = Horizon(12, 0.05, 0.8, 0.05, "definition")
    assert tracking(model, policy, _reward(1.0), MeanOnly(), definition) is None
    other = _reward(1.0)
    other.state_cost[0, 0] += 1
    assert tracking(model, policy, other, MeanOnly(), HORIZON) is None


def test_the_reward_is_the_distance() -> None:
    state = Masses().initial(torch.rand(4, 10, dtype=torch.float64))
    scaled = state / torch.tensor([q.scale for q in SPEC.state])
    reward = _reward(2.0)(scaled, torch.zeros(4, M, dtype=torch.float64))
    torch.testing.assert_close(reward, -2 * (state[:, :5] - state[:, 12:]).square().sum(-1))
