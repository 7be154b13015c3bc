"""edtorch-train and edtorch-eval on the arm: what they leave, and that it is taken up again."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from safetensors.torch import load_file

pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")

from edtorch.app.build import build
from edtorch.app.checkpoints import last_checkpoint
from edtorch.app.rundir import load_config
from edtorch.run.training import Training
from sims.cardea import cardea
from sims.workers import Workers
from tests.app.deadly import step_rows_or_die

Command = Callable[..., Any]
SHORT = ("experiment=cardea", "seeds=2", "train.seconds=6", "eval.episodes=3")
FIGURES = {
    "joint_error_rad",
    "joint_error_median_rad",
    "joint_speed_rad_s",
    "wrist_error_cm",
    "level_error_deg",
    "crash_rate",
    "success_rate",
}

pytestmark = pytest.mark.experiment


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, quick_command: Command) -> Path:
    """A short run of two learners."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    result = quick_command(
        "edtorch-train",
        *SHORT,
        "eval.minutes=[0.05]",
        f"hydra.run.dir={folder}",
    )
    assert result.status == 0, result.err
    return folder


def test_summary_figure_and_pictures(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert [e["minutes"] for e in summary["evaluations"]] == pytest.approx([0.05, 0.1])
    assert summary["final"] == summary["evaluations"][-1]
    for evaluation in summary["evaluations"]:
        assert set(evaluation) == FIGURES | {"minutes", "episode_s", "failure_rate", "return"}
        for name in FIGURES:
            spread = evaluation[name]
            assert set(spread) == {"per_seed", "median", "min", "max"}
            assert len(spread["per_seed"]) == 2
            assert spread["min"] <= spread["median"] <= spread["max"]
    with Image.open(run / "reach.webp") as animation:
        assert getattr(animation, "n_frames", 1) > 8
    assert (run / "learning_curve.svg").exists()
    with (run / "episodes.csv").open(newline="") as file:
        assert all(float(row["joint_error_rad"]) > 0 for row in csv.DictReader(file))


def test_a_run_goes_on_from_its_checkpoint_and_is_evaluated(run: Path, command: Command) -> None:
    setup = build(load_config(run))
    restored, anew = (
        Training(setup.learner, setup.world, setup.seeds, setup.budget, 1) for _ in range(2)
    )
    checkpoint = last_checkpoint(run)
    assert checkpoint is not None
    restored.restore(checkpoint.state["work"]["training"], [])
    anew.advance(300)
    assert restored.clock == anew.clock == 300
    for name in ("model", "policy", "fit", "step"):
        saved, again = getattr(restored.learners, name), getattr(anew.learners, name)
        assert all(torch.equal(saved[key], again[key]) for key in again), name
    result = command("edtorch-eval", f"run={run}", "episodes=2", "baselines=true")
    assert result.status == 0, result.err
    (written,) = run.glob("eval_*.json")
    figures = json.loads(written.read_text())
    assert set(figures) > FIGURES
    assert set(figures["baselines"]) == {"computed_torque", "pd_gravity", "pd", "nothing"}
    assert figures["baselines"]["nothing"]["crash_rate"]["median"] == 1


def test_keeps_the_best_policy_by_other_episodes(
    run: Path, command: Command, workplace: Path
) -> None:
    folder = workplace / "kept"
    result = command(
        "edtorch-train",
        *SHORT,
        "eval.minutes=[0.05]",
        "eval.keep=4",
        "log.figures=false",
        f"hydra.run.dir={folder}",
    )
    assert result.status == 0, result.err
    kept, plain = (json.loads((f / "summary.json").read_text()) for f in (folder, run))
    assert kept["evaluations"] == plain["evaluations"]
    assert "kept" not in plain
    when = kept["kept"]["minutes"]["per_seed"]
    by_minutes = {e["minutes"]: e for e in kept["evaluations"]}
    for name in FIGURES:
        for seed, minutes in enumerate(when):
            own = kept["kept"][name]["per_seed"][seed]
            assert own == by_minutes[minutes][name]["per_seed"][seed]
    saved, last = (load_file(f / "policy.safetensors") for f in (folder, run))
    for seed, minutes in enumerate(when):
        is_last = bool((saved["weight"][seed] == last["weight"][seed]).all())
        assert is_last == (minutes == kept["final"]["minutes"])


def _episodes(run: Path, seed: int) -> list[dict[str, str]]:
    with (run / "episodes.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["seed"] == str(seed)]


@pytest.mark.long
def test_learning_goes_on_where_a_worker_died(
    run: Path, command: Command, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The very first state of the first learner is deadly, to every process that takes it."""
    setup = build(load_config(run))
    start = Training(setup.learner, setup.world, setup.seeds, setup.budget).worlds.world
    mortal = Workers(partial(step_rows_or_die, float(start[0, 0])), 2)
    monkeypatch.setattr(cardea, "workers", lambda count: mortal)
    folder = workplace / "mortal"
    named = "cardea: row 0: two processes died of its step: its episode ends as a failure"
    computed_again = pytest.warns(RuntimeWarning, match="its 1 rows are computed again")
    with computed_again, pytest.warns(RuntimeWarning, match=named):
        result = command("edtorch-train", *SHORT, "domain.workers=2", f"hydra.run.dir={folder}")
    processes = mortal.processes()
    mortal.close()
    assert result.status == 0, result.err
    assert len(processes) == 2

    summary = json.loads((folder / "summary.json").read_text())
    assert summary["lost_episodes"] == 1
    # The step that was none taught nothing; all others did.
    assert summary["simulated_seconds"] == pytest.approx([5.98, 6.0])
    # The episode that was lost is not among those of the learner.
    later = _episodes(folder, 0)
    assert later and float(later[0]["start_s"]) == pytest.approx(0.02)
    undisturbed = [(row["start_s"], row["outcome"]) for row in _episodes(run, 1)]
    assert [(row["start_s"], row["outcome"]) for row in _episodes(folder, 1)] == undisturbed
    assert summary["not_finite"] == {}


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["seeds=100000"], r"seeds=100000: takes about [\d.]+ GiB of memory"),
        (["transform=first", "noise=linear"], r"noise\._target_=.*expected noise=residual"),
        (["transform=cubature", "unroll.path=closed_form"], r"unroll\.path=closed_form: expected"),
        (["unroll.start_deviation=1"], r"unroll\.start_deviation=1.*transform=first takes it in"),
        (["unroll.start=origin"], r"unroll\.start=origin: expected state with an inverse"),
        (["unroll.direction=regulator"], r"unroll\.direction=regulator: expected gradient"),
        (["eval.keep=5", "eval.episodes=0"], r"eval\.keep=5: expected 0 with eval\.episodes=0"),
        (["noise.exploration_start=1"], r"noise\.exploration_start=1.*: expected null"),
        (["unroll.path=fast"], r"unroll\.path=fast: expected one of"),
        (["observation.delay=1"], r"observation\.delay=1: expected none with an inverse model"),
        (["log.value_error=true"], r"log\.value_error=true: expected false"),
        (["compute.native=on"], r"compute\.native=on: expected auto or off with an inverse model"),
    ],
)
def test_refusals(command: Command, overrides: list[str], message: str) -> None:
    result = command("edtorch-train", "experiment=cardea", *overrides)
    assert result.status != 0
    assert re.search(message, result.line)


@pytest.mark.parametrize("transform", ["first", "cubature"])
def test_learns_with_the_covariance(command: Command, workplace: Path, transform: str) -> None:
    folder = workplace / transform
    result = command(
        "edtorch-train",
        "experiment=cardea",
        "seeds=2",
        "train.seconds=0.5",
        "eval.episodes=0",
        "log.figures=false",
        f"transform={transform}",
        f"hydra.run.dir={folder}",
    )
    assert result.status == 0, result.err
    log = (folder / "run.log").read_text()
    how = {"first": "its adjoint written out", "cubature": "torch's differentiation"}[transform]
    assert f"inverse policy, with covariance, {how}" in log
    assert json.loads((folder / "summary.json").read_text())["not_finite"] == {}
