"""A rival with a search per seed, from end to end, on a scalar system that diverges by itself."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

Command = Callable[..., Any]

# s' = 1.5 s + a: left alone it leaves 1000 times its start within 20 steps; a = -s keeps it.
SYSTEM = (
    *("--config-dir", str(Path(__file__).parent / "conf")),
    "domain=linear",
    "domain.state_matrix=[[1.5]]",
    "domain.action_matrix=[[1.0]]",
    "domain.noise=0.01",
    "domain.time_limit=40",
    "model=next_state",
    "reward=quadratic",
    "+reward.state.s0=1",
    "rival=constant",
    "eval.episodes=4",
    "compute.native=off",
    "log.tensorboard=false",
    "log.progress=false",
)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, quick_command: Command) -> Path:
    path = tmp_path_factory.mktemp("runs") / "rival"
    result = quick_command(
        "edtorch-train",
        *SYSTEM,
        "seeds=3",
        "seed=5",
        "log.tensorboard=true",
        f"hydra.run.dir={path}",
    )
    assert result.status == 0, result.err
    assert "stable: 3 of 3 seeds" in result.out
    return path


def test_the_folder_is_complete(folder: Path) -> None:
    names = {p.name for p in folder.iterdir() if not p.name.startswith("events.out")}
    assert names == {
        "config.yaml",
        "metrics.csv",
        "policy.safetensors",
        "run.json",
        "run.log",
        "status.json",
        "summary.json",
    }
    assert _json(folder / "run.json")["seeds"] == [5, 6, 7]
    assert torch.equal(load_file(folder / "policy.safetensors")["weight"], -torch.ones(3, 1, 1))


def test_milestones_are_where_the_policies_became_good(folder: Path) -> None:
    """Seed k has its good policy from the checkpoint 3 + k on, at 2 s and a fall each."""
    summary = _json(folder / "summary.json")
    stable = summary["milestones"]["stable"]
    assert stable["seconds"]["per_seed"] == [6, 8, 10]
    assert stable["failures"]["per_seed"] == [3, 4, 5]
    assert stable["never"] == []
    assert "goal" not in summary["milestones"]  # the domain has none
    assert summary["failures_before_first_success"]["per_seed"] == [6, 6, 6]
    assert summary["simulated_seconds"] == [12, 12, 12]
    assert summary["failure_rate"]["per_seed"] == [0, 0, 0]
    assert len(summary["checkpoints"]) == 6


def test_the_metrics_are_the_checkpoints(folder: Path) -> None:
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 18
    own = [row for row in rows if row["seed"] == "6"]
    assert [float(row["failure_rate"]) for row in own] == [1, 1, 1, 0, 0, 0]


def test_budgets_and_milestones_end_a_seed(command: Command, workplace: Path) -> None:
    for name, more, seconds in (
        ("budget", "train.seconds=7", [8, 8]),
        ("until", "train.until=stable", [6, 8]),
    ):
        result = command("edtorch-train", *SYSTEM, "seeds=2", more, f"hydra.run.dir={name}")
        assert result.status == 0, result.err
        assert _json(workplace / name / "summary.json")["simulated_seconds"] == seconds


def test_a_solved_task_ends_a_seed_and_is_tried_again(command: Command, workplace: Path) -> None:
    """In other episodes than those that decided."""
    more = ("seeds=2", "eval.episodes=30", "+eval.solved.rate=1", "log.progress=false")
    result = command("edtorch-train", *SYSTEM, *more, "hydra.run.dir=solved")
    assert result.status == 0, result.err
    summary = _json(workplace / "solved" / "summary.json")
    assert summary["seconds_to_solved"]["per_seed"] == summary["simulated_seconds"] == [6, 8]
    assert summary["trials_to_solved"]["per_seed"] == [3, 4]
    assert summary["never_solved"] == []
    assert summary["success_rate"]["per_seed"] == [1, 1]
    never = command("edtorch-train", *SYSTEM, *more, "train.seconds=4", "hydra.run.dir=never")
    assert never.status == 0, never.err
    summary = _json(workplace / "never" / "summary.json")
    assert summary["seconds_to_solved"]["median"] is None
    assert summary["never_solved"] == [0, 1]


def test_a_report_reads_it(folder: Path, command: Command, workplace: Path) -> None:
    result = command("edtorch-report", str(folder), "--output", "page")
    assert result.status == 0, result.err
    assert (workplace / "page" / "report.html").is_file()


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["rival.pieces=0"], r"rival\.pieces=0: expected an integer >= 1"),
        (["+rival.peices=1"], r"rival\.peices=1: unknown key; did you mean rival\.pieces\?"),
        (["train.until=later"], r"train\.until=later: expected null or one of stable, goal"),
        (["+eval.solved.mean_return=1"], r"eval\.solved\.mean_return=1: expected null without"),
        (["eval.episodes=0"], r"eval\.episodes=0: expected an integer >= 1"),
        (["command=ramp", "command.component=s0"], r"command=ramp: expected free with a rival"),
        (["observation.delay=1"], r"observation\.delay=1.*expected 0 and nothing with a rival"),
        (["rival._target_=edtorch.policy.steps.PlainStep"], r"rival\._target_=.*lacks begin"),
    ],
    ids=lambda v: str(v)[:40],
)
def test_refuses_with_one_line(
    command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *SYSTEM, *arguments)
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []


def test_a_learner_has_no_milestone_to_end_at(command: Command, workplace: Path) -> None:
    result = command("edtorch-train", "train.until=goal")
    assert result.status == 1
    assert "train.until=goal: expected null without a rival" in result.line
