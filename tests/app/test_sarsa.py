"""experiment=bicycle_sarsa through the command: what it leaves, what it refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

Command = Callable[..., Any]

SMALL = (
    "experiment=bicycle_sarsa",
    "seeds=2",
    "train.seconds=3",
    "rival.every=1.5",
    "domain.time_limit=2",
    "eval.episodes=2",
    "compute.native=off",
    "log.tensorboard=false",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, quick_command: Command) -> Path:
    """Of a short run."""
    path = tmp_path_factory.mktemp("runs") / "sarsa"
    result = quick_command("edtorch-train", *SMALL, f"hydra.run.dir={path}")
    assert result.status == 0, result.err
    return path


@pytest.mark.experiment
def test_the_folder_is_complete(folder: Path) -> None:
    names = {p.name for p in folder.iterdir()}
    assert {"config.yaml", "metrics.csv", "policy.safetensors", "summary.json"} <= names
    assert json.loads((folder / "status.json").read_text())["status"] == "done"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["simulated_seconds"] == [3.0, 3.0]
    assert len(summary["checkpoints"]) == 2
    assert summary["first_goal"]["never"] == [0, 1]
    # The article's 3,456 boxes, and each in 20 directions to the goal; nine actions.
    assert load_file(folder / "policy.safetensors")["table"].shape == (2, 21 * 3456, 9)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["rival.discount=1"], r"rival\.discount=1\.0: expected a number in"),
        (["rival.tables.balance.lean=[1,0]"], r"rival\.tables\.balance\.lean=\[1\.0, 0\.0\]"),
        (
            ["domain.lean_acceleration=false"],
            r"rival\.tables\.balance\.lean_acceleration=\[.*\]: expected a component of bicycle",
        ),
        (["rival.policies=3"], r"rival\.policies"),
    ],
)
def test_refuses(command: Command, arguments: list[str], wanted: str) -> None:
    result = command("edtorch-train", *SMALL, *arguments)
    assert result.status != 0
    assert re.search(wanted, result.err), result.err
