"""experiment=footnote1 from end to end: what it leaves, that it repeats, what it refuses."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

Command = Callable[..., Any]

SMALL = (
    "experiment=footnote1",
    "rival.policies=12",
    "rival.runs=2",
    "rival.slots=16",
    "rival.look=16",
    "rival.processes=1",
    "compute.native=off",
    "domain.time_limit=0.4",
    "domain.physics.omega_max=0.02",
    "domain.goal_radius=998.2",
    "domain.start_heading_low=-1.6",
    "domain.start_heading_high=-1.5",
    "log.tensorboard=false",
)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, quick_command: Command) -> Path:
    """A small search with everything switched on."""
    path = tmp_path_factory.mktemp("runs") / "search"
    result = quick_command("edtorch-train", *SMALL, "log.tensorboard=true", f"hydra.run.dir={path}")
    assert result.status == 0, result.err
    assert "goal in 2 of 2 runs" in result.out
    return path


def test_the_folder_is_complete(folder: Path) -> None:
    names = {p.name for p in folder.iterdir() if not p.name.startswith("events.out")}
    assert names == {
        "checkpoints",
        "config.yaml",
        "metrics.csv",
        "policies.csv",
        "policy.safetensors",
        "run.json",
        "run.log",
        "status.json",
        "summary.json",
    }
    assert len(list(folder.glob("events.out.tfevents.*"))) == 1
    assert _json(folder / "status.json")["status"] == "done"
    assert _json(folder / "run.json")["seeds"] == [0]


def test_the_summary_agrees_with_the_files(folder: Path) -> None:
    summary = _json(folder / "summary.json")
    kinds = [row["kind"] for row in _rows(folder / "policies.csv")]
    shares = [summary[name] for name in ("goal", "stable_not_to_the_goal", "rejected")]
    assert sum(share["count"] for share in shares) == 12
    assert all(0 <= s["low"] <= s["rate"] <= s["high"] <= 1 for s in shares)
    assert kinds.count("goal") == shares[0]["count"] > 0
    assert kinds.count("stable") == shares[1]["count"]
    weights = load_file(folder / "policy.safetensors")["weight"]
    assert weights.shape == (shares[0]["count"], 2, 5)
    last = _rows(folder / "metrics.csv")[-1]
    assert (int(last["decided"]), int(last["goal"])) == (12, shares[0]["count"])
    assert summary["simulated_seconds"] == pytest.approx(summary["steps"] * 0.01)
    assert summary["steps"] <= summary["steps_done"]
    for name in ("steps_per_cpu_s", "wall_s", "cpu_s", "compile_cpu_s"):
        assert math.isfinite(summary[name]) and summary[name] >= 0
    assert summary["command"].startswith("edtorch-train experiment=footnote1")


@pytest.mark.long
@pytest.mark.experiment
def test_processes_and_lean_acceleration(command: Command, workplace: Path) -> None:
    """With six features; two processes find what one finds."""
    for name, processes in (("one", 1), ("two", 2)):
        result = command(
            "edtorch-train",
            *SMALL,
            "domain.lean_acceleration=true",
            f"rival.processes={processes}",
            f"hydra.run.dir={name}",
        )
        assert result.status == 0, result.err
    one, two = (_json(workplace / name / "summary.json") for name in ("one", "two"))
    assert one["features"] == 6
    for key in ("goal", "stable_not_to_the_goal", "steps", "episodes", "median_of_goal_policies"):
        assert one[key] == two[key], key
    policies = [(workplace / name / "policies.csv").read_text() for name in ("one", "two")]
    assert policies[0] == policies[1]


REFUSED = [
    (["rival.policies=0"], r"rival\.policies=0: expected an integer >= 1"),
    (["rival.runs=0"], r"rival\.runs=0: expected an integer >= 1"),
    (["rival.slots=1"], r"rival\.slots=1: expected an integer >= 2"),
    (["rival.processes=0"], r"rival\.processes=0: expected an integer >= 1"),
    (["rival.low=3"], r"rival\.low=3\.0: expected less than high, 2\.0"),
    (["rival.polices=3"], r"rival\.polices=3: unknown key; did you mean rival\.policies\?"),
    (["+rival.foo=3"], r"rival\.foo=3: unknown key"),
    (["rival._target_=edtorch.policy.steps.PlainStep"], r"rival"),
    (["rival=foo"], r"rival=foo: expected one of .*none, .*random_search"),
    (["seeds=2"], r"seeds=2: expected 1 with rival=random_search"),
    (["compute.native=perhaps"], r"compute\.native=perhaps: expected one of auto, on, off"),
    (["+domain.state_scale.lena=1"], r"domain\.state_scale='lena'.*expected names of"),
]


@pytest.mark.parametrize(("arguments", "wanted"), REFUSED, ids=lambda v: str(v)[:40])
def test_refuses_with_one_line(
    command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *SMALL, *arguments)
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []
