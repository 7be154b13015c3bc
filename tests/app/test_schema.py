"""Configurations checked against constructors: keys, types, defaults, former names."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import getitem
from typing import Any, Literal

import pytest

from edtorch.app import schema
from edtorch.app.compose import compose
from edtorch.app.errors import ConfigError
from edtorch.app.groups import TARGETED, SafeGroup
from edtorch.app.overrides import given_name, typing
from edtorch.app.schema import checked, checked_fields
from edtorch.renamed import RENAMED_KEYS, current_keys


def _square(x: float) -> float:
    return x * x


@dataclass(frozen=True)
class Part:
    mass: float = 2.0
    name: str = "part"


@dataclass(frozen=True)
class Whole:
    size: int
    rate: float = 0.5
    bound: float | None = None
    mode: Literal["slow", "fast"] = "slow"
    weights: Mapping[str, float] = field(default_factory=dict)
    places: Sequence[int] = (1, 2)
    part: Part = Part()
    function: Callable[[float], float] = _square
    anything: Any = None


def test_defaults_are_filled_in_and_numbers_are_of_their_types() -> None:
    found = checked_fields(Whole, {"size": 3, "rate": 1, "weights": {"x": 2}}).plain()
    assert found == {
        "size": 3,
        "rate": 1.0,
        "bound": None,
        "mode": "slow",
        "weights": {"x": 2.0},
        "places": [1, 2],
        "part": {"_target_": f"{__name__}.Part", "mass": 2.0, "name": "part"},
        "function": {"_target_": f"{__name__}._square", "_partial_": True},
        "anything": None,
    }
    assert isinstance(found["rate"], float) and isinstance(found["weights"]["x"], float)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sise": 3}, "sise=3: unknown key; did you mean size?"),
        ({"size": 3.5}, "size=3.5: expected an integer"),
        ({"size": True}, "size=true: expected an integer"),
        ({"size": None}, "size=null: expected a value, not null"),
        ({"rate": "much"}, "rate=much: expected a number"),
        ({"bound": "none"}, "bound=none: expected a number"),
        ({"mode": "quick"}, "mode=quick: expected one of slow, fast"),
        ({"weights": 3}, "weights=3: expected a mapping {NAME: VALUE}"),
        ({"weights": {"x": "y"}}, "weights.x=y: expected a number"),
        ({"places": 3}, "places=3: expected a list"),
        ({"places": [1, 2.5]}, "places[1]=2.5: expected an integer"),
    ],
)
def test_refusals_name_the_key(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        checked_fields(Whole, given)
    assert str(refusal.value).startswith(message)


def test_settings_of_a_default_object_change_it() -> None:
    domain = compose(["domain.physics.v=5"]).domain
    assert domain.physics.v == 5.0
    assert domain.physics.M_p == 60.0
    assert domain.integrate["_partial_"] is True


def test_settings_of_another_object_are_its_own() -> None:
    """A part of another class than the default's has none of the default's settings."""
    policy = compose(["experiment=gym_pendulum", "search/policy=mlp", "search/improver=adam"])
    assert policy.search.policy.keys() == {"_target_", "hidden"}
    assert policy.search.improver.belief is None


def test_what_no_file_lists_needs_no_plus() -> None:
    for sign in ("", "+", "++"):
        weights = compose([f"{sign}reward.state.lean_rate=3", f"{sign}domain.state_scale.lean=2"])
        assert weights.reward.state.lean_rate == 3.0
        assert weights.domain.state_scale.lean == 2.0


WITH_RIVALS = {
    "rival.fall_cost": "experiment=bicycle_pegasus",
    "rival.fall_penalty": "experiment=bicycle_sac",
    "search.degree": "experiment=gym_pendulum",
}


@pytest.mark.parametrize(("old", "new"), RENAMED_KEYS.items())
def test_former_names(old: str, new: str) -> None:
    experiment = WITH_RIVALS.get(old, "experiment=bicycle")
    wanted: Any = compose([experiment, f"{new}=5"])
    assert reduce(getitem, new.split("."), wanted) == 5
    assert compose([experiment, f"{old}=5"]) == wanted == compose([experiment, f"+{old}=5"])


def test_former_names_in_a_saved_configuration() -> None:
    saved = {
        "noise": {"_target_": "x", "exploration": 0.1, "rate": 2.0},
        "train": {"seconds": 3.0, "rides": 1},
        "search": {"_target_": "y", "degree": 2},
    }
    assert current_keys(saved) == {
        "noise": {"_target_": "x", "rate": 2.0},
        "exploration": {"deviation": 0.1},
        "train": {"seconds": 3.0, "successes": 1},
        "search": {"_target_": "y", "policy": {"degree": 2}},
    }
    assert "exploration" in saved["noise"]


def test_former_names_of_components() -> None:
    linear = ["domain=linear", "reward=quadratic", "command=ramp"]
    old = compose([*linear, "+reward.state.s0=2", "+reward.action.a0=3", "command.component=s0"])
    new = ["+reward.state.state_0=2", "+reward.action.action_0=3", "command.component=state_0"]
    assert old == compose([*linear, *new])
    bicycle = compose(["+reward.state.s0=2"])
    assert bicycle.reward.state.s0 == 2.0  # refused later, by the name that was typed
    with typing(["+reward.state.s7=1"]):
        assert given_name("reward.state.state_7") == "reward.state.s7"


def test_what_an_older_configuration_lacks_is_set_by_default() -> None:
    """Settings of groups without a class too, whatever a constructor's argument is called."""
    old = {"domain": {"_target_": "sims.bicycle.Bicycle"}, "command": {"variant": "safe"}}
    targets = {key: compose().plain()[key] for key in TARGETED}
    command = checked(targets | old).command
    assert command.plain() == dataclasses.asdict(SafeGroup())


def test_both_names_of_a_setting_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"noise\.exploration=1: is now called exploration\.dev"):
        compose(["noise.exploration=1", "exploration.deviation=2"])


def test_a_class_that_is_typed_does_not_get_the_settings_of_the_option() -> None:
    fit = compose(["fit._target_=edtorch.model.fit.RecursiveLeastSquares"]).fit
    assert "rate" not in fit and fit.forgetting == 1.0


def test_defaults_of_a_flat_configuration() -> None:
    found = schema.defaults({"fit._target_": "edtorch.model.fit.RecursiveLeastSquares"})
    assert found["fit.forgetting"] == 1.0
    assert found["exploration.decay"] == 0.3


def test_what_an_experiment_sets_for_another_option_can_be_left_out() -> None:
    typed = ["experiment=regulation", "reward=saturating"]
    with pytest.raises(ConfigError, match=r"another reward: leave it out with ~reward\.by_scale$"):
        compose(typed)
    assert "by_scale" not in compose([*typed, "~reward.by_scale"]).reward
