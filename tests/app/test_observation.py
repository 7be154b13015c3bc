"""A run through sensors leaves policies that can be tried again as they were."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]


@pytest.mark.experiment
def test_a_saved_policy_brings_what_it_estimates_the_state_with(
    command: Command, workplace: Path, quick: tuple[str, ...]
) -> None:
    folder = workplace / "run"
    world = ("experiment=bicycle_sensors", "domain.sim.time_limit=3")
    result = command("edtorch-train", *world, *quick, f"hydra.run.dir={folder}")
    assert result.status == 0, result.err
    summary = json.loads((folder / "summary.json").read_text())
    result = command("edtorch-eval", f"run={folder}", "episodes=1")
    assert result.status == 0, result.err
    again = json.loads(next(folder.glob("eval_*.json")).read_text())
    key = "path_length_m"
    assert again[key]["per_seed"] == summary[key]["per_seed"]
    assert summary["not_finite"] == {}
