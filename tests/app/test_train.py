"""edtorch-train and edtorch-eval from end to end: what they leave, and that it repeats."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.metadata import PLUGIN_NAME as HPARAMS

from edtorch.app.build import build
from edtorch.app.checkpoints import last_checkpoint
from edtorch.app.rundir import load_config
from edtorch.run.training import Training

Command = Callable[..., Any]

SPREADS = (
    "falls_before_first_ride",
    "seconds_before_first_ride",
    "falls_after_first_ride",
    "goal_time_s",
    "goal_rate",
    "path_length_m",
)
SECONDS = ("wall_s", "cpu_s", "ticks_per_cpu_s", "startup_s", "eval_s", "figures_s")
FILES = {
    "checkpoints",
    "config.yaml",
    "episodes.csv",
    "learning_curve.png",
    "learning_curve.svg",
    "metrics.csv",
    "policy.safetensors",
    "ride.webp",
    "run.json",
    "run.log",
    "status.json",
    "summary.json",
}
LINEAR = ("domain=linear", "reward=quadratic", "+reward.state.state_0=1", "domain.dt=0.1")


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_folder_is_complete(finished: Path) -> None:
    names = {p.name for p in finished.iterdir()}
    events = {name for name in names if name.startswith("events.out.tfevents.")}
    assert len(events) == 1
    assert names - events == FILES
    assert _json(finished / "status.json")["status"] == "done"
    about = _json(finished / "run.json")
    assert about["seeds"] == [3, 4]
    assert set(about) >= {"command", "versions", "git", "host"}
    with Image.open(finished / "learning_curve.png") as picture:
        assert picture.width > 500
    with Image.open(finished / "ride.webp") as animation:
        assert getattr(animation, "n_frames", 1) > 10
    assert (finished / "learning_curve.svg").read_text().rstrip().endswith("</svg>")


def test_the_summary_has_every_figure(finished: Path) -> None:
    summary = _json(finished / "summary.json")
    for name in SPREADS:
        assert set(summary[name]) == {"per_seed", "median", "min", "max"}, name
        assert len(summary[name]["per_seed"]) == 2, name
    for name in SECONDS:
        assert math.isfinite(summary[name]) and summary[name] >= 0, name
    assert summary["never_rode"] == [3, 4]
    assert summary["seconds_before_first_ride"]["per_seed"] == pytest.approx([12, 12])
    assert summary["falls_before_first_ride"]["median"] >= 1
    assert summary["goal_time_s"] == {
        "per_seed": [None, None],
        "median": None,
        "min": None,
        "max": None,
    }
    assert summary["command"].startswith("edtorch-train experiment=bicycle_squared")
    assert {"edtorch", "torch", "python"} <= set(summary["versions"])
    assert summary["ticks"] == 2 * 1200
    assert summary["ticks_per_cpu_s"] == pytest.approx(2400 / summary["cpu_s"])


def test_falls_are_those_of_the_episodes(finished: Path) -> None:
    falls = [0, 0]
    for row in _rows(finished / "episodes.csv"):
        falls[int(row["seed"]) - 3] += row["outcome"] == "failed"
    assert _json(finished / "summary.json")["falls_before_first_ride"]["per_seed"] == falls
    last = _rows(finished / "metrics.csv")[-2:]
    assert [int(row["falls"]) for row in last] == falls


def test_tensorboard_reads_it_back(finished: Path) -> None:
    board = EventAccumulator(str(finished), size_guidance={"images": 1, "scalars": 0})
    board.Reload()
    tags = board.Tags()
    assert {"learning/value", "falls/median", "population/active"} <= set(tags["scalars"])
    steps = [event.step for event in board.Scalars("learning/value")]
    assert steps == sorted({round(float(r["seconds"])) for r in _rows(finished / "metrics.csv")})
    by_second = {event.step: event.value for event in board.Scalars("falls/max")}
    assert by_second[12] == max(
        _json(finished / "summary.json")["falls_before_first_ride"]["per_seed"]
    )
    assert tags["images"] == ["learning_curve"]
    text = board.Tensors("config/text_summary")[0].tensor_proto.string_val[0].decode()
    assert "deviation: 0.05" in text and "edtorch.policy.steps.SaturatedStep" in text
    hparams = board.summary_metadata
    named = {tag: m.plugin_data.plugin_name for tag, m in hparams.items()}
    assert {tag for tag, plugin in named.items() if plugin == HPARAMS} == {
        "_hparams_/experiment",
        "_hparams_/session_start_info",
        "_hparams_/session_end_info",
    }
    started = hparams["_hparams_/session_start_info"].plugin_data.content
    assert b"exploration.deviation" in started and b"step.alpha" in started


def test_two_runs_have_the_same_digits(
    command: Command, workplace: Path, quick: tuple[str, ...]
) -> None:
    for name in ("a", "b"):
        command("edtorch-train", *quick, "seed=5", "compute.native=auto", f"hydra.run.dir={name}")
    for file in ("metrics.csv", "episodes.csv", "policy.safetensors", "config.yaml"):
        assert (workplace / "a" / file).read_bytes() == (workplace / "b" / file).read_bytes(), file
    a, b = (_json(workplace / name / "summary.json") for name in ("a", "b"))
    for key in (*SPREADS, "ticks", "simulated_seconds", "never_rode"):
        assert a[key] == b[key], key


def test_a_population_is_its_learners_one_by_one(
    command: Command, workplace: Path, quick: tuple[str, ...]
) -> None:
    long = (*quick, "train.seconds=8", "eval.episodes=2", "compute.native=auto")
    command("edtorch-train", *long, "seed=7", "seeds=3", "hydra.run.dir=all")
    everybody = load_file(workplace / "all" / "policy.safetensors")
    summary = _json(workplace / "all" / "summary.json")
    rows = _rows(workplace / "all" / "metrics.csv")
    for k in range(3):
        command("edtorch-train", *long, f"seed={7 + k}", "seeds=1", f"hydra.run.dir={k}")
        alone = load_file(workplace / str(k) / "policy.safetensors")
        for name, parameters in everybody.items():
            assert torch.equal(parameters[k], alone[name][0])
            assert parameters[k].abs().max() > 0
        own = _json(workplace / str(k) / "summary.json")
        for key in (*SPREADS, "episode_s"):
            assert summary[key]["per_seed"][k] == own[key]["per_seed"][0], key
        assert _rows(workplace / str(k) / "metrics.csv") == [
            row for row in rows if row["seed"] == str(7 + k)
        ]


def test_another_seed_learns_something_else(finished: Path) -> None:
    (weight,) = load_file(finished / "policy.safetensors").values()
    assert not torch.equal(weight[0], weight[1])


def test_the_checkpoint_is_the_last_tick(finished: Path) -> None:
    setup = build(load_config(finished))
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    checkpoint = last_checkpoint(finished)
    assert checkpoint is not None
    training.restore(checkpoint.state["work"]["training"], [])
    assert training.clock == 1200
    (weight,) = load_file(finished / "policy.safetensors").values()
    assert torch.equal(next(iter(training.learners.policy.values())), weight)


def test_without_evaluation_and_on_a_world_without_paths(command: Command, workplace: Path) -> None:
    """No evaluation: nulls; every episode of the linear system is a success."""
    result = command(
        "edtorch-train",
        *LINEAR,
        "seeds=2",
        "train.successes=2",
        "eval.episodes=0",
        "hydra.run.dir=x",
    )
    assert result.status == 0, result.err
    summary = _json(workplace / "x" / "summary.json")
    assert summary["failure_rate"]["median"] is None and "return" not in summary
    assert summary["final_size"]["per_seed"] == [None, None]
    assert summary["failures_before_first_success"]["per_seed"] == [0, 0]
    assert summary["seconds_before_first_success"]["per_seed"] == [0, 0]
    assert summary["never_succeeded"] == []
    assert max(summary["training"]["return"]["per_seed"]) < 0
    assert not any("ride" in key or "fall" in key or "goal" in key for key in summary)
    assert not (workplace / "x" / "success.webp").exists()
    assert (workplace / "x" / "learning_curve.png").exists()


@pytest.mark.parametrize("policy", ["linear", "squashed"])
def test_the_value_error_estimate_is_logged_on_request(
    command: Command, workplace: Path, policy: str
) -> None:
    """It vanishes where the closed loop is linear, and only there."""
    result = command(
        "edtorch-train",
        *LINEAR,
        f"policy={policy}",
        "seeds=2",
        "train.seconds=3",
        "eval.episodes=0",
        "unroll.horizon=3",
        "step.alpha=30",
        "log.every=1",
        "log.value_error=true",
        "log.figures=false",
        "compute.native=off",
        "hydra.run.dir=x",
    )
    assert result.status == 0, result.err
    estimates = [float(row["value_error_estimate"]) for row in _rows(workplace / "x/metrics.csv")]
    assert len(estimates) == 6
    sizes = [abs(estimate) for estimate in estimates]
    assert (max(sizes) < 1e-12) if policy == "linear" else (max(sizes) > 1e-9)
    events = EventAccumulator(str(workplace / "x"))
    events.Reload()
    assert len(events.Scalars("learning/value error estimate")) == 3


def test_a_run_in_which_no_episode_ends(command: Command, workplace: Path) -> None:
    """The figures show the episode so far."""
    result = command(
        "edtorch-train", "seeds=1", "train.seconds=1", "eval.episodes=0", "hydra.run.dir=x"
    )
    assert result.status == 0, result.err
    assert _rows(workplace / "x" / "episodes.csv") == []
    assert (workplace / "x" / "learning_curve.png").exists()
    with Image.open(workplace / "x" / "ride.webp") as animation:
        assert getattr(animation, "n_frames", 1) == 11


def test_output_fits_80_columns_where_there_is_no_terminal(
    command: Command, workplace: Path, quick: tuple[str, ...]
) -> None:
    result = command("edtorch-train", *quick, "hydra.run.dir=x")
    assert "falls before the first ride" in result.out
    assert f"run folder: {workplace / 'x'}" in result.out.splitlines()
    table = [line for line in result.out.splitlines() if "│" in line]
    assert table and max(len(line) for line in table) <= 80
    assert "\x1b" not in result.out + result.err


def test_sweep(command: Command, workplace: Path, quick: tuple[str, ...]) -> None:
    """Each job has a complete folder of its own, with its own setting."""
    result = command(
        "edtorch-train", "-m", *quick, "noise.exploration=0.02,0.05", "hydra.sweep.dir=s"
    )
    assert result.status == 0, result.err
    for name, deviation in (("0", 0.02), ("1", 0.05)):
        folder = workplace / "s" / name
        assert _json(folder / "status.json")["status"] == "done"
        assert load_config(folder).exploration.deviation == deviation
        assert {"summary.json", "metrics.csv", "policy.safetensors"} <= {
            p.name for p in folder.iterdir()
        }


def test_bad_job_of_a_sweep(command: Command, workplace: Path, quick: tuple[str, ...]) -> None:
    """It is named as the user named it, and the others are done."""
    result = command(
        "edtorch-train", "-m", *quick, "noise.exploration=-1,0.02", "hydra.sweep.dir=s"
    )
    assert result.status == 1
    why = "noise.exploration=-1.0: expected a finite number >= 0"
    assert _json(workplace / "s/0/status.json") == {"status": "failed", "why": why}
    assert f"edtorch-train: {workplace / 's/0'}: {why}" in result.err.splitlines()
    assert _json(workplace / "s" / "1" / "status.json")["status"] == "done"


def test_evaluation_of_a_run(
    command: Command, workplace: Path, finished: Path, quick_runs: Callable[..., None]
) -> None:
    """By default it repeats the evaluation of the run; settings of the world can be changed."""
    quick_runs("train.seconds=8", "seed=3", "eval.episodes=2", f"hydra.run.dir={workplace / 'r'}")
    assert command("edtorch-eval", "run=r", "episodes=2").status == 0
    (path,) = (workplace / "r").glob("eval_*.json")
    again, before = _json(path), _json(workplace / "r" / "summary.json")
    for key in (*SPREADS[3:], "episode_s", "fall_rate"):
        assert again[key] == before[key], key
    path.unlink()
    result = command("edtorch-eval", "run=r", "episodes=2", "+domain.noise=0.0")
    assert result.status == 0
    (path,) = (workplace / "r").glob("eval_*.json")
    assert _json(path)["domain"] == {"noise": 0.0}
    assert _json(path)["episode_s"] != before["episode_s"]
    assert {"fall", "rate"} <= set(result.out.split())
    path.unlink()
    policy = f"policy={finished / 'policy.safetensors'}"
    assert command("edtorch-eval", "run=r", "episodes=2", policy).status == 0
    (path,) = (workplace / "r").glob("eval_*.json")
    assert _json(path)["episode_s"] != before["episode_s"]


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--help"], "edtorch-train"),
        (["--cfg", "job"], "deviation: 0.05"),
        (["--info", "defaults"], "saturated"),
    ],
)
def test_hydra_s_own_options(
    command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *arguments)
    assert result.status == 0
    assert wanted in result.out
    assert list(workplace.iterdir()) == []


def test_paths_are_relative_to_where_the_command_was_called(
    command: Command, workplace: Path
) -> None:
    (workplace / "data.npz").write_bytes(b"not a file of arrays")
    data = ("experiment=bicycle_offline", "offline.data=data.npz")
    result = command("edtorch-train", *data, "hydra.job.chdir=true")
    assert result.status == 1
    assert "data.npz: cannot be read as an .npz file of arrays" in result.err
