"""What is told about a system, and what cannot be true together."""

from __future__ import annotations

from dataclasses import replace

import pytest

from edtorch.model.told import Told
from sims.base import Quantity, Spec
from tests.cart_poles import spec

PLAIN = Spec(
    name="plain",
    state=(Quantity("x", "m"), Quantity("v", "m/s"), Quantity("a", "m/s^2"), Quantity("goal", "m")),
    action=(Quantity("force", "N"),),
    dt=0.1,
    time_limit=1.0,
    disturbance_dim=0,
    reset_dim=0,
    clip_action=False,
    headline="x",
    goal=("goal",),
    tracked=("x",),
)


def test_the_spec_tells_angles_and_rates() -> None:
    told = Told.of(spec(), invariant=["position"])
    assert told.angle == (False, False, True, False)
    assert told.rate_of == (-1, 0, -1, 2) and told.rate == (1, -1, 3, -1)
    assert told.learned == (1, 3) and told.acting == (1, 2, 3)
    assert told.words == (
        "angles: angle; rates: speed of position, rate of angle; invariant: position"
    )


def test_nothing_is_guessed() -> None:
    told = Told.of(PLAIN)
    assert told.constant == {"goal"}  # the spec says so
    assert told.learned == (0, 1, 2) and told.rate_of == (-1,) * 4
    assert replace(told, constant=frozenset()).words == "nothing"


def test_told_by_name() -> None:
    told = Told.of(PLAIN, rates={"v": "x", "a": "v"}, angles=["x"], ignored=["goal"][:0])
    assert told.learned == (2,) and told.rate == (1, 2, -1, -1) and told.angle[0]


def test_an_ignored_component_is_neither_learned_nor_used() -> None:
    told = Told.of(PLAIN, rates={"v": "x"}, ignored=["x"])
    assert told.learned == (1, 2) and told.acting == (1, 2, 3)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"angles": ["y"]}, r"told.angles='y': .* one of x, v, a, goal"),
        ({"rates": {"v": "y"}}, r"told.rates='y'"),
        ({"invariant": ["y"]}, r"told.invariant='y'"),
        ({"rates": {"v": "x", "a": "x"}}, r"'a' is the rate of 'x', and 'v' is as well"),
        ({"rates": {"v": "x"}, "angles": ["v"]}, r"expected no angle, which 'v'"),
        ({"rates": {"v": "x"}, "constant": ["x"]}, r"'x', which is told to be constant"),
        ({"rates": {"v": "x"}, "ignored": ["v"]}, r"expected both ignored, or none"),
        ({"rates": {"v": "x", "x": "v"}}, r"without a ring"),
        ({"rates": {"v": "v"}}, r"without a ring"),
        ({"ignored": ["goal"]}, r"'goal' is in both"),
        ({"ignored": ["x"], "invariant": ["x"]}, r"'x' is in both"),
        ({"ignored": ["x", "v", "a"]}, r"none to learn"),
    ],
)
def test_refuses_in_one_line(given: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words) as error:
        Told.of(PLAIN, **given)
    assert "\n" not in str(error.value)


def test_an_angle_is_in_radians() -> None:
    with pytest.raises(ValueError, match=r"period of 'x' is 360.0 deg: expected an angle in rad"):
        Told.of(replace(PLAIN, state=(Quantity("x", "deg", period=360.0), *PLAIN.state[1:])))
