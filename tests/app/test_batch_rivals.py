"""Batch rivals by the command: what they leave, what they refuse."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from safetensors.torch import load_file

Command = Callable[..., Any]

SMALL = ("seeds=2", "domain.time_limit=2", "eval.episodes=2", "log.tensorboard=false")
LSPI = ("experiment=bicycle_lspi", "rival.episodes=[10,20]", *SMALL)
FITTED_Q = (
    "experiment=bicycle_fitted_q",
    *("rival.episodes=3", "rival.iterations=3", "rival.every=2", "rival.rebuilt=1"),
    *("rival.trees=2", *SMALL),
)
NAMES = {
    "checkpoints",
    "config.yaml",
    "metrics.csv",
    "policy.safetensors",
    "run.json",
    "run.log",
    "status.json",
    "summary.json",
}


def _run(command: Command, workplace: Path, arguments: tuple[str, ...]) -> dict[str, Any]:
    result = command("edtorch-train", *arguments, "hydra.run.dir=run")
    assert result.status == 0, result.err
    assert {p.name for p in (workplace / "run").iterdir()} == NAMES
    return json.loads((workplace / "run" / "summary.json").read_text())


@pytest.mark.experiment
def test_lspi_leaves_a_complete_folder(command: Command, workplace: Path) -> None:
    summary = _run(command, workplace, LSPI)
    assert summary["episodes"]["per_seed"] == [20, 20]
    for found, seconds in zip(summary["checkpoints"], (2, 4), strict=True):
        assert found["seconds"]["per_seed"] == pytest.approx([seconds, seconds])
    assert load_file("run/policy.safetensors")["weight"].shape == (2, 5, 20)


@pytest.mark.experiment
def test_fitted_q_leaves_its_forests(command: Command, workplace: Path) -> None:
    summary = _run(command, workplace, FITTED_Q)
    assert summary["episodes"]["per_seed"] == [3, 3] == summary["falls"]["per_seed"]
    assert len(summary["checkpoints"]) == 2
    stored = load_file("run/policy.safetensors")
    assert stored["first"].shape == (2, 2)
    assert stored["value"].shape == stored["threshold"].shape


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ([*LSPI, "rival.discount=1"], r"rival\.discount=1\.0: expected a number in \[0, 1\)"),
        ([*LSPI, "rival.episodes=[]"], r"rival\.episodes=\[\]: expected rising integers >= 1"),
        ([*LSPI, "rival.epsiodes=[1]"], r"rival\.epsiodes=\[1\]: unknown key; did you mean"),
        ([*LSPI, "+eval.domain.goal=2"], r"eval\.domain\.goal=2: unknown key"),
        ([*FITTED_Q, "rival.trees=0"], r"rival\.trees=0: expected an integer >= 1"),
    ],
    ids=lambda v: str(v[-1])[:40],
)
def test_refuses_with_one_line(
    command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *arguments)
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ([*LSPI, "rival.basis=[[lena]]"], r"rival\.basis\[0\]=\['lena'\]: expected names of lean"),
        ([*LSPI, "rival.actions=[[1],[2]]"], r"rival\.actions\[0\]=\[1\]: expected 2 finite"),
        ([*FITTED_Q, "+rival.reward_size.lena=1"], r"rival\.reward_size\.lena=1\.0: expected one"),
    ],
    ids=lambda v: str(v[-1])[:40],
)
def test_refuses_what_the_domain_has_not(
    command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    """Seen when the search begins: the folder says that it failed, and why."""
    result = command("edtorch-train", *arguments, "hydra.run.dir=run")
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    status = json.loads((workplace / "run" / "status.json").read_text())
    assert status["status"] == "failed"
