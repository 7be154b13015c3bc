"""edtorch-eval with the runs of rivals: the policies that they left ride as they did at the end."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]

SMALL = (
    "seeds=2",
    "domain.time_limit=4",
    "eval.episodes=3",
    "compute.native=off",
    "log.tensorboard=false",
)
RUNS = {
    "sarsa": ("experiment=bicycle_sarsa", "train.seconds=3", "rival.every=3", *SMALL),
    "lspi": ("experiment=bicycle_lspi", "rival.episodes=[20]", *SMALL),
    "ppo": (
        "experiment=bicycle_ppo",
        "train.seconds=4",
        "rival.copies=2",
        "rival.rollout=32",
        "rival.steps=64",
        *SMALL,
    ),
    "lqr": ("experiment=bicycle_lqr", *SMALL),
}
SAME = ("goal_rate", "fall_rate", "episode_s", "path_length_m")


def _evaluated(command: Command, folder: Path, *arguments: str) -> dict[str, Any]:
    result = command("edtorch-eval", f"run={folder}", "episodes=3", *arguments)
    assert result.status == 0, result.err
    (path,) = folder.glob("eval_*.json")
    return json.loads(path.read_text())


@pytest.mark.experiment
@pytest.mark.parametrize("name", RUNS)
def test_a_policy_rides_as_at_the_end_of_its_run(
    name: str, quick_command: Command, tmp_path: Path
) -> None:
    """The episodes are the same, to the last digit but where a compiled program ran them."""
    folder = tmp_path / name
    result = quick_command("edtorch-train", *RUNS[name], f"hydra.run.dir={folder}")
    assert result.status == 0, result.err
    summary = json.loads((folder / "summary.json").read_text())
    start = ("domain.start_lean=0", "domain.start_handlebar=0") if name == "lspi" else ()
    found = _evaluated(quick_command, folder, *(f"+{key}" for key in start))
    assert found["seeds"] == [0, 1]
    for key in SAME:
        for ours, theirs in zip(found[key]["per_seed"], summary[key]["per_seed"], strict=True):
            assert ours == (None if theirs is None else pytest.approx(theirs, rel=1e-6))


@pytest.mark.long
@pytest.mark.experiment
def test_the_policies_of_a_search_have_numbers(quick_command: Command, tmp_path: Path) -> None:
    folder = tmp_path / "search"
    result = quick_command(
        "edtorch-train",
        "experiment=bicycle_random_search",
        "rival.policies=30",
        "rival.runs=2",
        "rival.slots=8",
        "domain.time_limit=2",
        "log.tensorboard=false",
        "compute.native=off",
        f"hydra.run.dir={folder}",
    )
    assert result.status == 0, result.err
    result = quick_command("edtorch-eval", f"run={folder}", "episodes=1")
    assert result.status != 0
    assert "holds no policy; none of the search reached the goal" in result.err


@pytest.mark.experiment
def test_trees_are_refused_by_name(quick_command: Command, tmp_path: Path) -> None:
    folder = tmp_path / "trees"
    few = ("rival.episodes=5", "rival.iterations=1", "rival.trees=2")
    arguments = ("experiment=bicycle_fitted_q", *few, *SMALL, f"hydra.run.dir={folder}")
    result = quick_command("edtorch-train", *arguments)
    assert result.status == 0, result.err
    result = quick_command("edtorch-eval", f"run={folder}", "episodes=1")
    assert result.status != 0
    assert re.search(r"rival=FittedQ: expected policies that are tensors", result.err)
    assert not list(folder.glob("eval_*.json"))
