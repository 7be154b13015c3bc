"""Policies linear in products of the lift."""

from __future__ import annotations

import math

import pytest
import torch

from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.policy.lifted import LiftedPolicy
from edtorch.policy.squash import Squash
from tests import cart_poles
from tests.systems import normal

SQUASH = Squash(torch.tensor([0.5]).double(), torch.tensor([2.0]).double())
LIFT = Lift.of(cart_poles.told())
ODD = Terms.of_state(LIFT, range(4), 3, odd=True)


def _random(policy: LiftedPolicy) -> dict[str, torch.Tensor]:
    shape = policy.initial([0, 1])["weight"].shape
    return {"weight": normal(torch.Generator().manual_seed(0), *shape)}


def test_an_odd_policy_acts_the_other_way_in_the_mirror_image() -> None:
    policy = LiftedPolicy(LIFT, ODD, SQUASH)
    parameters, state = _random(policy), normal(torch.Generator().manual_seed(1), 5, 2, 4)
    one, other = policy.action(parameters, state), policy.action(parameters, -state)
    assert one.shape == (5, 2, 1)
    assert torch.allclose(one - 0.5, 0.5 - other, atol=1e-14)
    turned = state + torch.tensor([0.0, 0.0, 2 * math.pi, 0.0])
    assert torch.allclose(policy.action(parameters, turned), one, atol=1e-12)


def test_one_weight_is_one_monomial() -> None:
    """theta of (sin angle)(cos angle) rate alone."""
    policy, state = LiftedPolicy(LIFT, ODD, SQUASH), normal(torch.Generator().manual_seed(2), 1, 4)
    names = ("sin angle", "cos angle", "rate")
    wanted = sorted(LIFT.entry(name) for name in names)
    everything = Terms.of_state(LIFT, range(4), 3)
    assert not (ODD.factors == wanted).all(1).any()  # it is even
    place = int((everything.factors == wanted).all(1).argmax())
    policy = LiftedPolicy(LIFT, everything, SQUASH)
    weight = policy.initial([0])["weight"]
    assert torch.equal(policy.action({"weight": weight}, state), SQUASH.middle.expand(1, 1))
    weight[0, 0, place] = 0.7
    angle, rate = state[0, 2], state[0, 3]
    raw = 0.7 * angle.sin() * angle.cos() * rate
    assert torch.allclose(policy.action({"weight": weight}, state)[0, 0], 0.5 + 2 * raw.tanh())


def test_the_sets_are_counted() -> None:
    """Monomials of an angle and a rate, 1..3, without squares of the cosine: 3 + 5 + 7."""
    assert Terms.of_state(LIFT, [2, 3], 3).count == 15
    assert Terms.of_state(LIFT, [2, 3], 3, odd=True).count == 8
    assert (Terms.of_state(LIFT, [2, 3], 3).factors.any(1)).all()


def test_actions_are_no_features() -> None:
    with pytest.raises(ValueError, match="terms: expected none with actions"):
        LiftedPolicy(LIFT, Terms.implicit(cart_poles.told(), LIFT), SQUASH)
