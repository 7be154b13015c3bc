"""Stops as they are told."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from edtorch.model.stops import Stops
from edtorch.model.told import Told
from sims.tasks.stop_pendulum import StopPendulum
from sims.tasks.walker import Walker

ROD, WALKER = Told.of(StopPendulum().spec), Told.of(Walker(foot=False).spec)


def test_a_knee_is_a_difference_of_angles() -> None:
    given = {"of": {"stance_shank": 1.0, "stance_thigh": -1.0}, "column": "stance_knee", "at": 0.0}
    knee = Stops.of(WALKER, {"knee": given})
    state = torch.zeros(3, 10, dtype=torch.float64)
    state[:, WALKER.names.index("stance_shank")] = torch.tensor([0.3, 0.1, 3.1]).double()
    state[:, WALKER.names.index("stance_thigh")] = torch.tensor([0.1, 0.3, -3.1]).double()
    # The last has the knee bent by 6.2 rad, nearly all around, or by -0.08, which is near.
    assert knee.gaps(state)[:, 0].tolist() == pytest.approx(
        [0.2, -0.2, 6.2 - 2 * math.pi], abs=1e-6
    )
    assert knee.column.tolist() == [WALKER.actions.index("stance_knee")]
    assert knee.words == "knee 0"


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"of": {"angel": 1.0}, "column": "torque"}, "told.stops.s.of: 'angel' is no component"),
        ({"of": {"rate": 1.0}, "column": "torque"}, "told.stops.s.of: 'rate' has no learned rate"),
        (
            {"of": {"angle": 0.0}, "column": "torque"},
            "told.stops.s.of.angle=0.0: expected a number",
        ),
        ({"of": {"angle": 1.0}, "column": "force"}, "told.stops.s.column=force: expected one of"),
        ({"of": {"angle": 1.0}}, "told.stops.s=.*: expected {of: {position: factor}"),
        ({"of": {}, "column": "torque"}, "told.stops.s.of: expected a position"),
        ({"of": {"angle": 1.0}, "column": "torque", "att": 1.0}, "told.stops.s=.*att.*: expected"),
        (
            {"of": {"angle": 1.0}, "column": "torque", "at": "here"},
            "told.stops.s.at=here: expected",
        ),
    ],
)
def test_what_cannot_be_is_an_error(entry: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match="(?s)" + message.replace("{", r"\{")):
        Stops.of(ROD, {"s": entry})
    with pytest.raises(ValueError, match=r"told\.stops\.s=3: expected"):
        Stops.of(ROD, {"s": 3})


def test_walls_that_leave_no_room_are_an_error() -> None:
    walls = {
        "lower": {"of": {"angle": 1.0}, "column": "torque", "at": 1.0},
        "upper": {"of": {"angle": -1.0}, "column": "torque", "at": -0.5},
    }
    with pytest.raises(ValueError, match=r"lower\.at=1, told\.stops\.upper\.at=-0\.5: no room"):
        Stops.of(ROD, walls)
    with pytest.raises(ValueError, match=r"told\.stops: 7 of them, expected 6 at most"):
        Stops.of(ROD, {str(k): walls["lower"] for k in range(7)})
