"""Arguments of ``edtorch.learn`` of the wrong kind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from edtorch.app.arguments import check_kinds, in_arguments
from edtorch.app.errors import ConfigError


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("dt", "0.1", "dt='0.1': expected a number of seconds"),
        ("time_limit", True, "time_limit=True: expected a number of seconds"),
        ("names", "xy", "names='xy': expected a list of names"),
        ("action_names", [1], r"action_names=\[1\]: expected a list of names"),
        ("target", [0.0], r"target=\[0.0\]: expected {NAME: NUMBER, ...}"),
        ("weights", 1.0, "weights=1.0: expected {NAME: NUMBER, ...}"),
        ("rates", ["w"], r"rates=\['w'\]: expected {RATE: COMPONENT, ...}"),
        ("angles", "theta", "angles='theta': expected a list of names, or"),
        ("overrides", "step.alpha=1", "overrides='step.alpha=1': expected a list of texts"),
    ],
)
def test_kinds(name: str, value: Any, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        check_kinds({name: value})


def test_kinds_that_fit() -> None:
    check_kinds({"dt": np.float32(0.1), "names": ("x", "y"), "angles": ["x"], "target": None})


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ("domain.state_scale.x=1: expected", "scale.x=1: expected"),
        ("domain.angles.x: not there", "angles.x: not there"),
        ("reward.state.x=-1: expected", "weights.x=-1: expected"),
    ],
)
def test_messages_name_the_argument(message: str, told: str) -> None:
    assert in_arguments(message) == told
