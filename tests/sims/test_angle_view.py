"""Angles among the components of an observation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sims.angle_hint import AngleHint
from sims.angle_view import angle_view, with_rates, wrapped
from sims.base import Quantity

NAMES = ("x", "cos", "sin", "speed")
QUANTITIES = tuple(Quantity(name, "1") for name in NAMES)


@given(st.floats(-50, 50), st.floats(-7, 7))
def test_wrapping_adds_whole_turns_around_the_middle(angle: float, around: float) -> None:
    found = float(wrapped(torch.tensor(angle, dtype=torch.float64), 2 * math.pi, around))
    turns = (found - angle) / (2 * math.pi)
    assert abs(turns - round(turns)) < 1e-12
    assert around - math.pi - 1e-9 < found <= around + math.pi + 1e-9


def test_inside_the_range_nothing_changes() -> None:
    angle = torch.linspace(-3, 3, 7).double()
    assert torch.equal(wrapped(angle, 2 * math.pi), angle)


def test_a_pair_becomes_its_angle_in_the_place_of_the_first() -> None:
    view, quantities = angle_view(QUANTITIES, {"theta": ("cos", "sin")})
    assert [q.name for q in quantities] == ["x", "theta", "speed"]
    assert quantities[1].period == 2 * math.pi and quantities[1].unit == "rad"
    theta = torch.linspace(-3.1, 3.1, 9).double()
    seen = view(torch.stack([theta + 5, theta.cos(), theta.sin(), 2 * theta], dim=-1))
    torch.testing.assert_close(seen, torch.stack([theta + 5, theta, 2 * theta], dim=-1))


def test_a_pair_around_half_a_turn_is_continuous_there() -> None:
    view, _ = angle_view(QUANTITIES, {"theta": {"pair": ["cos", "sin"], "around": math.pi}})
    theta = math.pi + torch.tensor([-0.1, -1e-9, 1e-9, 0.1]).double()
    zero = torch.zeros(4).double()
    seen = view(torch.stack([zero, theta.cos(), theta.sin(), zero], dim=-1))[:, 1]
    torch.testing.assert_close(seen, theta)


def test_degrees_and_names_alone() -> None:
    view, quantities = angle_view(QUANTITIES, {"x": "deg"})
    assert quantities[0].period == 360 and quantities[0].unit == "deg"
    assert float(view(torch.tensor([350.0, 0, 0, 0]))[0]) == -10
    assert angle_view(QUANTITIES, ["x"])[1][0].period == 2 * math.pi


@pytest.mark.parametrize(
    ("angles", "message"),
    [
        (["theta"], "angles.theta: 'theta' is not one of x, cos, sin, speed"),
        ({"x": "turns"}, "angles.x='turns': expected 'rad', 'deg', or the names"),
        ({"theta": ("cos",)}, "angles.theta=('cos',): expected 'rad', 'deg', or the names"),
        ({"theta": ("cos", "cos")}, "expected two components used only here"),
        ({"theta": ("cos", "sin"), "phi": ("cos", "x")}, "'cos'"),
        ({"x": ("cos", "sin")}, "expected a name that no component has"),
    ],
)
def test_refusals(angles: Any, message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        angle_view(QUANTITIES, angles)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("moving", "told"),
    [
        (lambda t: [t, math.cos(t), math.sin(t)], "(b, c) look like cosine and sine of an angle"),
        (lambda t: [math.cos(t), t, math.sin(2 * t)], None),
        (lambda t: [t, 1.0, 0.0], None),
    ],
)
def test_a_pair_on_the_unit_circle_is_noticed_once(moving: Any, told: str | None) -> None:
    hint = AngleHint(["a", "b", "c"])
    lines = [hint.add(np.array(moving(0.01 * k))) for k in range(500)]
    said = [line for line in lines if line]
    assert len(said) == (told is not None)
    assert told is None or said[0].startswith(told)


def test_rates() -> None:
    assert with_rates(QUANTITIES, {"speed": "x"})[3].rate_of == "x"
    with pytest.raises(ValueError, match=r"rates.speed=y: 'y' is not one of"):
        with_rates(QUANTITIES, {"speed": "y"})
