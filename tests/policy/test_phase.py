"""Policies by a phase: curves, gains, names, and the vector of their parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from edtorch.policy.phase import PhaseGait, PhasePolicy
from edtorch.policy.squash import Squash
from tests.systems import f64

NAMES, UNIT, RATE = ("lean", "hip", "lean_rate", "hip_rate"), (1.0, 2.0, 3.0, 4.0), (2, 3, -1, -1)
GAIT = PhaseGait(
    phase={"lean": 1.0, "hip": 0.5},
    start=-0.2,
    width=0.4,
    spread=0.1,
    joints={
        "swing": {
            **{"of": {"hip": 1.0}, "drives": {"b": 1.0}, "stiffness": 4.0, "damping": 0.4},
            **{"points": [0.1, 0.5, -0.3, 0.2], "spread": 0.1},
            **{"feedback": 0.1, "spread_feedback": 0.05},
        },
        "bend": {
            **{"of": {"hip": 1.0, "lean": -1.0}, "drives": {"a": -1.0, "b": 0.5}},
            **{"stiffness": 2.0, "damping": 0.1, "points": [0.3], "spread": 0.05},
        },
    },
)
SWING: dict[str, Any] = dict(GAIT.joints["swing"])
SQUASH = Squash(f64([0.0, 0.5]), f64([1.0, 2.0]))


def policy(gait: PhaseGait = GAIT) -> PhasePolicy:
    return PhasePolicy(gait, NAMES, UNIT, RATE, ("a", "b"), SQUASH)


def test_the_raw_action_is_that_of_the_formula() -> None:
    found, generator = policy(), np.random.default_rng(0)
    parameters = found.random(5, 1.0, generator)
    state = torch.from_numpy(generator.normal(size=(5, 4)))
    raw = found.raw(parameters, state)
    for k in range(5):
        lean, hip, lean_rate, hip_rate = (state[k] * f64(UNIT)).tolist()
        own = {name: p[k].tolist() for name, p in parameters.items()}
        start, width = own["phase"]
        tau = min(max((lean + 0.5 * hip - start) / width, 0.0), 1.0)
        curve = [math.comb(3, i) * tau**i * (1 - tau) ** (3 - i) for i in range(4)]
        target = sum(b * p for b, p in zip(curve, own["swing"], strict=True))
        target += own["feedback"][0] * (lean_rate + 0.5 * hip_rate)
        swing = 4.0 * (target - hip) - 0.4 * hip_rate
        bend = 2.0 * (own["bend"][0] - hip + lean) - 0.1 * (hip_rate - lean_rate)
        assert raw[k].tolist() == pytest.approx([-bend, swing + 0.5 * bend], abs=1e-12)
    bounded = SQUASH.middle + SQUASH.half * raw.tanh()
    assert torch.equal(found.action(parameters, state), bounded)


def test_a_curve_begins_and_ends_at_its_outer_points() -> None:
    found = policy(replace(GAIT, joints={"swing": SWING | {"feedback": None}}))
    parameters = found.initial([0])
    for lean, point in ((-0.9, 0.1), (0.9, 0.2)):
        raw = found.raw(parameters, f64([[lean, 0.0, 0.0, 0.0]]))
        assert raw.tolist() == [[0.0, pytest.approx(4.0 * point)]]


def test_the_vector_holds_all_parameters() -> None:
    found = policy()
    parameters = found.random(3, 1.0, np.random.default_rng(1))
    vector = found.vector(parameters)
    assert vector.shape == (3, found.size) == (3, 8)
    again = found.of_vector(vector)
    assert {name: p.shape[1] for name, p in again.items()} == {
        **{"phase": 2, "swing": 4, "bend": 1, "feedback": 1}
    }
    assert all(torch.equal(p, parameters[name]) for name, p in again.items())
    first = found.vector(found.initial([0, 1]))
    assert first[1].tolist() == [-0.2, 0.4, 0.1, 0.5, -0.3, 0.2, 0.3, 0.1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0.0}, "width=0.0: expected a number > 0"),
        (
            {"phase": {"knee": 1.0}},
            "phase.knee: expected positions whose rates are read: lean, hip",
        ),
        (
            {"joints": {"swing": SWING | {"drives": {"c": 1.0}}}},
            "joints.swing.drives.c: expected names of a, b",
        ),
        (
            {"joints": {"swing": SWING | {"points": []}}},
            "joints.swing.points: no value given",
        ),
        (
            {"joints": {"swing": SWING | {"gain": 1.0}}},
            "joints.swing.gain: expected one of of, drives, stiffness",
        ),
        ({"joints": {"phase": SWING}}, "joints.phase: expected another name"),
    ],
)
def test_what_is_no_gait_is_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        policy(replace(GAIT, **change))
