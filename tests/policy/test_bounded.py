"""Stationary policies of the lift: radial basis functions and networks beside their formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from edtorch.model.lift import Lift
from edtorch.policy.bounded import BoundedPolicy, OddPolicy
from edtorch.policy.network import NetworkPolicy
from edtorch.policy.radial import RadialPolicy
from edtorch.policy.squash import Squash
from tests import cart_poles
from tests.systems import normal

SQUASH = Squash(torch.tensor([0.5]).double(), torch.tensor([2.0]).double())
LIFT = Lift.of(cart_poles.told())
PLACES = [2, 3]
"""Angle and rate."""


def _inputs(state: torch.Tensor) -> np.ndarray:
    """sin, cos of the angle, and the rate, in the lift's order."""
    angle, rate = state[2].item(), state[3].item()
    return np.array([math.sin(angle), math.cos(angle), rate])


def _radial(*, normalised: bool) -> RadialPolicy:
    return RadialPolicy(LIFT, PLACES, SQUASH, centres=4, width=0.7, normalised=normalised)


@pytest.mark.parametrize("normalised", [False, True])
def test_radial_functions_are_their_formula(normalised: bool) -> None:
    policy = _radial(normalised=normalised)
    parameters = policy.random(2, 1.5, np.random.default_rng(0))
    parameters["log_width"] += torch.tensor([0.0, 0.3, -0.2])
    state = normal(torch.Generator().manual_seed(1), 5, 2, 4)
    found = policy.action(parameters, state)
    for b in range(2):
        weight, centre, width = (
            parameters[name][b].numpy() for name in ("weight", "centre", "log_width")
        )
        for i in range(5):
            away = (_inputs(state[i, b]) - centre) / np.exp(width)
            phi = np.exp(-0.5 * (away**2).sum(1))
            z = weight @ (phi / phi.sum() if normalised else phi)
            assert found[i, b, 0].item() == pytest.approx(0.5 + 2 * math.tanh(z[0]), abs=1e-12)


def test_a_network_is_its_layers() -> None:
    policy = NetworkPolicy(LIFT, PLACES, SQUASH, hidden=(5, 3))
    parameters = policy.random(2, 2.0, np.random.default_rng(0))
    state = normal(torch.Generator().manual_seed(1), 6, 2, 4)
    found = policy.action(parameters, state)
    for b in range(2):
        own = [p[b].numpy() for p in parameters.values()]
        for i in range(6):
            x = _inputs(state[i, b])
            x = np.tanh(own[0] @ x + own[1])
            x = np.tanh(own[2] @ x + own[3])
            z = own[4] @ x + own[5]
            assert found[i, b, 0].item() == pytest.approx(0.5 + 2 * math.tanh(z[0]), abs=1e-12)


@pytest.mark.parametrize(
    "policy",
    [_radial(normalised=False), NetworkPolicy(LIFT, PLACES, SQUASH, hidden=(5,))],
    ids=lambda policy: policy.label,
)
def test_an_odd_one_acts_the_other_way_in_the_mirror_image(policy: BoundedPolicy) -> None:
    odd = OddPolicy(policy)
    parameters = odd.random(3, 1.0, np.random.default_rng(0))
    state = normal(torch.Generator().manual_seed(1), 5, 3, 4)
    one, other = odd.action(parameters, state), odd.action(parameters, -state)
    assert torch.allclose(one - 0.5, 0.5 - other, atol=1e-14)
    turned = state + torch.tensor([0.0, 0.0, 2 * math.pi, 0.0])
    assert torch.allclose(odd.action(parameters, turned), one, atol=1e-12)
    raw = (policy.raw(parameters, state) - policy.raw(parameters, -state)) / 2
    assert torch.equal(odd.action(parameters, state), SQUASH(raw))
    assert odd.label == f"Odd{policy.label}"


def test_restarts_are_drawn_by_the_generator_alone() -> None:
    for policy in (_radial(normalised=True), NetworkPolicy(LIFT, PLACES, SQUASH, hidden=(5,))):
        one, same, other = (policy.random(2, 1.0, np.random.default_rng(k)) for k in (0, 0, 1))
        assert all(torch.equal(one[name], same[name]) for name in one)
        assert not all(torch.equal(one[name], other[name]) for name in one)
        shapes = {name: p.shape[1:] for name, p in policy.initial([0]).items()}
        assert shapes == {name: p.shape[1:] for name, p in one.items()}


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="centres=0: expected an integer >= 1"):
        RadialPolicy(LIFT, PLACES, SQUASH, centres=0)
    with pytest.raises(ValueError, match="width=-1: expected a number > 0"):
        RadialPolicy(LIFT, PLACES, SQUASH, centres=3, width=-1)
    with pytest.raises(ValueError, match=r"hidden=\[4, 0\]: expected integers >= 1"):
        NetworkPolicy(LIFT, PLACES, SQUASH, hidden=(4, 0))
