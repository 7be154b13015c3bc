"""A strike from its settings: contradictory ones raise an error that names them."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from edtorch.model.lift import Lift
from edtorch.model.strike import Strike
from edtorch.model.told import Told
from sims.tasks.walker import Walker
from tests.systems import f64

SPEC = Walker().spec
TOLD = Told.of(SPEC, ignored=("steps", "force_x", "force_y"))
SIGNS = {"stance": 0.4, "swing": -0.4}
HEIGHT = {f"{leg}_{link}": sign for leg, sign in SIGNS.items() for link in ("shank", "thigh")}
SWAP = {f"stance_{part}": f"swing_{part}" for part in ("shank", "thigh", "knee", "hip")}


def strike(height: dict[str, float] | None = None, **swap: str | None) -> Strike:
    """The walker's strike with some pairs of the swap replaced; None leaves a pair out."""
    pairs = {a: b for a, b in (SWAP | swap).items() if b is not None}
    given = HEIGHT if height is None else height
    return Strike.of(TOLD, Lift.of(TOLD), height=given, swap=pairs, counter="steps")


def test_the_height_changes_its_sign_where_legs_change_places() -> None:
    found, state = (
        strike(),
        torch.randn(5, len(TOLD.names), generator=torch.manual_seed(0)).double(),
    )
    lift = Lift.of(TOLD)
    unit = f64(TOLD.unit)
    names = list(TOLD.names)
    by_hand = sum(
        length * torch.cos(state[:, names.index(name)] * unit[names.index(name)])
        for name, length in HEIGHT.items()
    )
    torch.testing.assert_close(found.of_state(lift, state), by_hand)
    torch.testing.assert_close(found.of_state(lift, found.relabelled(state)), -by_hand)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"stance_hip": "swing_knee"}, "'swing_knee' is given 2 times"),
        ({"stance_hip": "stance_hip"}, "'stance_hip' is given 2 times"),
        ({"stance_shank": "swing_thigh"}, "'swing_thigh' is given 2 times"),
        ({"stance_shank": "wing"}, "'wing' is unknown; expected one of"),
        ({"stance_shank": "torso"}, "expected the same but for its sign"),
        ({"stance_shank": None}, "expected the same but for its sign"),
        ({"height": dict.fromkeys(HEIGHT, 0.0)}, "lengths that are not all zero"),
        ({"height": {}}, "lengths that are not all zero"),
        (
            {"height": HEIGHT | {"stance_shank": 0.5}},
            "makes the height .*expected the same but for its sign",
        ),
    ],
)
def test_contradictory_settings_are_rejected(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        strike(**given)
