"""Policies linear in the readings: what a search begins with, and what is left out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from edtorch.model.told import Told
from edtorch.policy.linear_gait import LinearGait, LinearGaitPolicy
from edtorch.policy.phase import PhaseGait
from tests.policy.test_phase import GAIT, NAMES, SQUASH, SWING, UNIT

TOLD = Told(NAMES, UNIT, (False,) * 4, (-1, -1, 0, 1), ("a", "b"))


def policy(about: PhaseGait | None = GAIT, told: Told = TOLD) -> LinearGaitPolicy:
    return LinearGait(about).policy(told, SQUASH)


def test_it_begins_as_a_gait_whose_curves_are_straight() -> None:
    straight = SWING | {"points": [0.5, 0.2, -0.1, -0.4]}
    gait = replace(GAIT, joints=dict(GAIT.joints) | {"swing": straight})
    found, curved = policy(gait), gait.policy(TOLD, SQUASH)
    # The phase is within a step where the lean is within (-0.2, 0.2) and the hip small.
    lean, hip = np.random.default_rng(0).uniform(-0.1, 0.1, (2, 20))
    rates = np.random.default_rng(1).normal(size=(20, 2))
    state = torch.from_numpy(np.column_stack([lean, hip / 2, rates]))
    wanted = curved.raw(curved.initial([0] * 20), state)
    torch.testing.assert_close(found.raw(found.initial([0] * 20), state), wanted)


def test_a_line_is_the_nearest_to_its_curve() -> None:
    """The stiffness of the joint is 4, and its target all that depends on the lean."""
    gait = replace(GAIT, joints={"swing": SWING | {"feedback": None}})
    found = policy(gait)
    tau = np.linspace(0, 1, 2001)
    curve = sum(
        math.comb(3, k) * tau**k * (1 - tau) ** (3 - k) * point
        for k, point in enumerate(SWING["points"])
    )
    slope, first = np.polyfit(tau, curve, 1)
    lean = torch.from_numpy(gait.start + gait.width * np.array([0.0, 1.0])).unsqueeze(-1)
    state = torch.cat([lean, torch.zeros(2, 3).double()], dim=-1)
    raw = found.raw(found.initial([0, 0]), state)[:, 1] / 4.0
    assert raw.tolist() == pytest.approx([first, first + slope], abs=1e-3)


def test_without_a_gait_it_begins_at_zero() -> None:
    found = policy(None)
    assert all(not bool(p.any()) for p in found.initial([0]).values())
    drawn = found.random(4000, 2.0, np.random.default_rng(0))
    for name, spread in (("gain", 1.0), ("constant", 0.4)):
        assert float(drawn[name].std()) == pytest.approx(spread, rel=0.05)


def test_what_is_ignored_is_not_read() -> None:
    found = policy(None, replace(TOLD, ignored=frozenset({"hip", "hip_rate"})))
    parameters = found.random(1, 1.0, np.random.default_rng(0))
    assert parameters["gain"].shape == (1, 2, 2)
    state = torch.ones(1, 4).double()
    other = state.clone()
    other[:, 1::2] = 7.0
    assert torch.equal(found.raw(parameters, state), found.raw(parameters, other))
    other[:, 2] = 7.0
    assert not torch.equal(found.raw(parameters, state), found.raw(parameters, other))


@pytest.mark.parametrize("name", ["spread", "spread_constant"])
def test_what_does_not_spread_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}=0.0: expected a number > 0"):
        LinearGait(None, **{name: 0.0})
