"""The rivals with a search per seed, from end to end: what they leave, what they refuse."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

Command = Callable[..., Any]

SYSTEM = (
    "domain=linear",
    "domain.state_matrix=[[1.05]]",
    "domain.action_matrix=[[0.5]]",
    "domain.time_limit=6",
    "reward=quadratic",
    "+reward.state.s0=1",
    "+reward.action.a0=0.3",
    "compute.native=off",
    "seeds=2",
    "seed=3",
    "train.successes=null",
    "train.seconds=300",
    "eval.episodes=3",
)
SMALL = {
    "adaptive_lqr": ("rival.piece=50",),
    "lqr": (),
    "pegasus": ("rival.gradients=2", "rival.scenarios=5"),
    "reinforce": ("rival.batch=10", "rival.updates=2"),
}


@pytest.mark.parametrize("name", SMALL)
def test_the_folder_is_complete(name: str, command: Command, workplace: Path) -> None:
    result = command(
        "edtorch-train", f"rival={name}", *SYSTEM, *SMALL[name], f"hydra.run.dir={workplace / name}"
    )
    assert result.status == 0, result.err
    names = {p.name for p in (workplace / name).iterdir()}
    wanted = {"config.yaml", "metrics.csv", "policy.safetensors", "run.json", "status.json"}
    assert wanted | {"summary.json"} <= names
    summary = json.loads((workplace / name / "summary.json").read_text())
    assert load_file(workplace / name / "policy.safetensors")["weight"].shape == (2, 1, 1)
    with (workplace / name / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["seed"] for row in rows} == {"3", "4"}
    lived = summary["simulated_seconds"]
    if name == "lqr":
        assert lived == [0.0, 0.0]
        assert summary["milestones"]["stable"]["seconds"]["max"] == 0
        # It costs no experience, but Riccati's equation costs time.
        assert summary["milestones"]["stable"]["cpu_s"]["min"] > 1e-4
    else:
        assert all(seconds > 0 for seconds in lived)
        last = [float(row["simulated_seconds"]) for row in rows[-2:]]
        assert sorted(last) == sorted(lived)
    # Nothing fails in this world within its time.
    assert summary["milestones"]["stable"]["never"] == []


REFUSED = [
    ("pegasus", "rival.gradients=0", r"rival\.gradients=0: expected an integer >= 1"),
    ("pegasus", "rival.discount=2", r"rival\.discount=2\.0: expected a number in \(0, 1\]"),
    ("pegasus", "rival.senarios=3", r"rival\.senarios=3: unknown key; did you mean rival\.scen"),
    ("reinforce", "rival.discount=1", r"rival\.discount=1\.0: expected a number between 0 and 1"),
    ("adaptive_lqr", "rival.piece=0", r"rival\.piece=0\.0: expected a number > 0"),
    ("lqr", "reward.action.a0=0", r"rival.*reward\.action: expected a cost > 0 of every action"),
    ("lqr", "policy=squashed", r"rival.*policy: expected policy=linear"),
    ("lqr", "train.until=there", r"train\.until=there: expected null or one of stable, goal"),
]


@pytest.mark.parametrize(("name", "setting", "wanted"), REFUSED, ids=lambda v: str(v)[:30])
def test_refuses_with_one_line(
    name: str, setting: str, wanted: str, command: Command, workplace: Path
) -> None:
    result = command("edtorch-train", f"rival={name}", *SYSTEM, setting)
    assert result.status != 0
    assert re.search(wanted, result.line), result.line
