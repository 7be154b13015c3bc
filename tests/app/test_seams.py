"""Targets near the place where an angle wraps."""

from __future__ import annotations

import pytest

from edtorch.app.reward import near_seams
from edtorch.app.settings import Settings
from sims.from_gymnasium import GymnasiumSim


@pytest.mark.parametrize(
    ("around", "target", "near"),
    [(0.0, 3.0, "3.14159"), (0.0, -2.0, "-3.14159"), (0.0, 1.0, None), (3.0, 3.0, None)],
)
def test_a_line_for_each(around: float, target: float, near: str | None) -> None:
    angles = {"theta": {"pair": ["state_0", "state_1"], "around": around}}
    spec = GymnasiumSim("Pendulum-v1", angles=angles).spec
    lines = near_seams(Settings({"target": Settings({"theta": target})}), spec)
    assert len(lines) == (near is not None)
    assert near is None or f"reward.target.theta={target}: near {near} rad" in lines[0]
