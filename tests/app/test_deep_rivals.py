"""SAC and PPO from end to end: the run folder, that it repeats, and what is refused."""

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

SMALL = {
    "sac": ("experiment=bicycle_sac", "rival.steps=105", "rival.hidden=[8,8]"),
    "ppo": (
        "experiment=bicycle_ppo",
        "rival.steps=128",
        "rival.rollout=16",
        "rival.hidden=[8,8]",
    ),
}
QUICK = (
    "seeds=2",
    "seed=4",
    "rival.repeat=2",
    "train.seconds=4",
    "eval.episodes=1",
    "log.tensorboard=false",
    "log.progress=false",
)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


@pytest.mark.experiment
@pytest.mark.parametrize("name", SMALL)
def test_the_folder_is_complete_and_repeats(command: Command, workplace: Path, name: str) -> None:
    for folder, more in (("one", ()), ("again", ("seeds=1", "seed=5"))):
        arguments = (*SMALL[name], *QUICK, *more, f"hydra.run.dir={folder}")
        result = command("edtorch-train", *arguments)
        assert result.status == 0, result.err
    folder = workplace / "one"
    assert {p.name for p in folder.iterdir()} == {
        "config.yaml",
        "metrics.csv",
        "policy.safetensors",
        "run.json",
        "run.log",
        "status.json",
        "summary.json",
    }
    assert _json(folder / "status.json")["status"] == "done"
    one, again = (_json(workplace / name / "summary.json") for name in ("one", "again"))
    assert one["seeds"] == [4, 5]
    assert all(4 <= seconds < 10 for seconds in one["simulated_seconds"])
    assert one["simulated_seconds"][1:] == again["simulated_seconds"]
    assert one["falls"]["per_seed"][1:] == again["falls"]["per_seed"] != [0]
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    last = [row for row in rows if row["seed"] == "5"][-1]
    assert int(last["falls"]) == again["falls"]["per_seed"][0]
    # Seed 5 does the same beside seed 4 and alone.
    both, alone = (load_file(workplace / name / "policy.safetensors") for name in ("one", "again"))
    assert both["weight_1"].shape == (2, 8, 5)
    for key in ("weight_1", "bias_2", "weight_3"):
        assert both[key][1].equal(alone[key][0])


@pytest.mark.parametrize(
    ("name", "arguments", "wanted"),
    [
        ("sac", ["rival.steps=0"], r"rival\.steps=0: expected an integer >= 1"),
        (
            "sac",
            ["rival.failure_penalty=-1"],
            r"rival\.failure_penalty=-1\.0: expected a finite number",
        ),
        ("sac", ["rival.copies=2"], r"rival\.copies=2: unknown key"),
        ("ppo", ["rival.rollout=7"], r"rival\.rollout=7: .* copies=8 is a multiple of 64"),
        ("ppo", ["rival.hidden=[]"], r"rival\.hidden=\[\]: expected units of each layer"),
        ("ppo", ["rival.discount=2"], r"rival\.discount=2\.0: expected a number in \[0, 1\]"),
    ],
    ids=lambda v: str(v)[:40],
)
def test_refuses_with_one_line(
    command: Command, workplace: Path, name: str, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *SMALL[name], *QUICK, *arguments)
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []


@pytest.mark.parametrize("name", SMALL)
def test_names_the_extra(
    command: Command, workplace: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edtorch.rivals.deep.is_installed", lambda: False)
    result = command("edtorch-train", *SMALL[name], *QUICK)
    assert result.status == 1
    assert 'pip install "edtorch[rivals]"' in result.line
    assert list(workplace.iterdir()) == []
