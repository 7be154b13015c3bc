"""Milestones of a learner, from end to end: what it had paid, and that trying costs it nothing."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]
# An episode is 2.5 s long, so that there are rides.
SHORT = (
    "experiment=bicycle_squared",
    "seeds=3",
    "seed=3",
    "train.seconds=7.5",
    "train.successes=null",
    "domain.time_limit=2.5",
    "eval.episodes=4",
    "compute.native=off",
    "log.tensorboard=false",
    "log.figures=false",
)
MINUTES = (0.02, 0.05, 0.1)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory, quick_command: Command) -> tuple[Path, Path]:
    """The same learners with and without evaluations on the way."""
    made = tmp_path_factory.mktemp("runs")
    tried = f"eval.minutes=[{','.join(map(str, MINUTES))}]"
    for name, more in (("tried", [tried]), ("plain", [])):
        result = quick_command("edtorch-train", *SHORT, *more, f"hydra.run.dir={made / name}")
        assert result.status == 0, result.err
        if more:
            assert "after 0.05 min: stable " in result.out
    return made / "tried", made / "plain"


@pytest.mark.experiment
def test_learners_do_the_same_whether_they_are_tried_or_not(folders: tuple[Path, Path]) -> None:
    tried, plain = (_json(folder / "summary.json") for folder in folders)
    assert tried.keys() - plain.keys() == {"milestones", "checkpoints"}
    for key in ("falls_before_first_ride", "simulated_seconds", "goal_rate", "episode_s"):
        assert tried[key] == plain[key], key
    episodes = [(folder / "episodes.csv").read_text() for folder in folders]
    assert episodes[0] == episodes[1]
    policies = [(folder / "policy.safetensors").read_bytes() for folder in folders]
    assert policies[0] == policies[1]


@pytest.mark.experiment
def test_what_was_paid_until_then(folders: tuple[Path, Path]) -> None:
    """Falls and episodes as the table of episodes has them, counted again."""
    summary = _json(folders[0] / "summary.json")
    with (folders[0] / "episodes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    checkpoints = summary["checkpoints"]
    times = [60 * m for m in MINUTES] + [7.5]
    assert 1 <= len(checkpoints) <= len(times)
    for place, found in enumerate(checkpoints):
        for k, seed in enumerate(summary["seeds"]):
            seconds = found["seconds"]["per_seed"][k]
            if seconds is None:
                continue
            assert seconds == pytest.approx(times[place]) or place == len(checkpoints) - 1
            ended = [
                row
                for row in rows
                if int(row["seed"]) == seed
                and float(row["start_s"]) + float(row["seconds"]) <= seconds + 1e-6
            ]
            assert found["episodes"]["per_seed"][k] == len(ended)
            falls = sum(row["outcome"] == "failed" for row in ended)
            assert found["falls"]["per_seed"][k] == falls
    last = [c["cpu_s"]["per_seed"] for c in checkpoints]
    for k in range(3):
        spent = [own[k] for own in last if own[k] is not None]
        assert spent == sorted(spent) and spent[0] > 0
    assert sum(max(own[k] or 0 for own in last) for k in range(3)) <= summary["cpu_s"] * 1.05


@pytest.mark.experiment
def test_milestones_are_the_first_checkpoints_that_are(folders: tuple[Path, Path]) -> None:
    summary = _json(folders[0] / "summary.json")
    stable = summary["milestones"]["stable"]
    for k, seed in enumerate(summary["seeds"]):
        first = [
            c["seconds"]["per_seed"][k]
            for c in summary["checkpoints"]
            if c["fall_rate"]["per_seed"][k] == 0
        ]
        if seed in stable["never"]:
            assert not first
            assert stable["seconds"]["per_seed"][k] == pytest.approx(7.5)
        else:
            assert stable["seconds"]["per_seed"][k] == first[0]
    # Nobody is at a goal 1 km away in 2.5 s: all are censored, with all that they have paid.
    assert summary["milestones"]["goal"]["never"] == summary["seeds"]
    assert summary["milestones"]["goal"]["seconds"]["per_seed"] == summary["simulated_seconds"]
    assert summary["milestones"]["goal"]["path_length_m"]["median"] is None


SOLVED = (
    *("experiment=figure1", "seeds=2", "train.seconds=60", "eval.episodes=5"),
    *("+eval.solved.rate=1", "compute.native=off", "log.tensorboard=false", "log.figures=false"),
)


@pytest.mark.parametrize(("minutes", "seconds"), [("[0.5,0.75]", 30), ("[]", 60)])
def test_a_task_counts_as_solved_where_it_is_first_looked_at(
    command: Command, workplace: Path, minutes: str, seconds: float
) -> None:
    """Nothing in this loop fails, so that every policy is good."""
    place = "hydra.run.dir=run"
    result = command("edtorch-train", *SOLVED, f"eval.minutes={minutes}", place)
    assert result.status == 0, result.err
    summary = _json(workplace / "run" / "summary.json")
    assert summary["seconds_to_solved"]["per_seed"] == pytest.approx([seconds] * 2)
    assert summary["never_solved"] == []
    assert summary["success_rate"]["per_seed"] == [1, 1]
    assert summary["simulated_seconds"] == [60, 60]


def test_whether_a_task_is_solved_takes_episodes(command: Command, workplace: Path) -> None:
    result = command("edtorch-train", *SOLVED, "eval.episodes=0")
    assert result.status == 1
    assert "eval.episodes=0: expected an integer >= 1" in result.line
    assert list(workplace.iterdir()) == []
