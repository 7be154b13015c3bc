"""Policies and exploration."""

from __future__ import annotations

import pytest
import torch

from edtorch.model.features import Affine, Identity, Pairwise
from edtorch.policy.policies import LinearPolicy, SquashedPolicy, explore
from tests.systems import normal


def test_linear_and_squashed() -> None:
    g = torch.Generator().manual_seed(0)
    weight, s = normal(g, 4, 2, 3), normal(g, 4, 3)
    for kind, bend in ((LinearPolicy, lambda x: x), (SquashedPolicy, torch.tanh)):
        policy = kind(3, 2, Identity(3))
        action = torch.func.functional_call(policy, {"weight": weight}, (s,))
        wanted = torch.stack([bend(weight[b] @ s[b]) for b in range(4)])
        assert torch.allclose(action, wanted, rtol=1e-13)


def test_only_the_plain_linear_policy_has_a_gain() -> None:
    weight = torch.ones(2, 3)
    gain = LinearPolicy(3, 2, Identity(3)).linear_gain({"weight": weight})
    assert gain is not None and gain.state is weight and gain.constant is None
    assert SquashedPolicy(3, 2, Identity(3)).linear_gain({"weight": weight}) is None
    assert LinearPolicy(3, 2, Pairwise(3)).linear_gain({"weight": weight}) is None
    bias = torch.arange(8.0).reshape(2, 4)
    affine = LinearPolicy(3, 2, Affine(3)).linear_gain({"weight": bias})
    assert affine is not None and affine.constant is not None
    assert torch.equal(affine.state, bias[:, 1:]) and torch.equal(affine.constant, bias[:, 0])
    # A gradient with respect to the gain goes back to where the gain came from.
    assert torch.equal(LinearPolicy(3, 2, Affine(3)).of_gain(affine)["weight"], bias)
    assert torch.equal(LinearPolicy(3, 2, Identity(3)).of_gain(gain)["weight"], weight)


def test_exploration_has_the_deviation_asked_for() -> None:
    g = torch.Generator().manual_seed(1)
    action = torch.full((20_000, 1), 0.3, dtype=torch.float64)
    noisy = explore(action, normal(g, 20_000, 1), 0.05)
    assert float(noisy.mean()) == pytest.approx(0.3, abs=5 * 0.05 / 20_000**0.5)
    assert float(noisy.std()) == pytest.approx(0.05, rel=0.03)
    assert torch.equal(explore(action, action, 0.0), action)


def test_refuses_features_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match="takes 2 inputs, expected 3 states"):
        LinearPolicy(3, 2, Identity(2))
