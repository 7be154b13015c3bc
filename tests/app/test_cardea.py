"""edtorch-train and edtorch-eval on the arm: what they leave, and that it is taken up again."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")

from edtorch.app.build import build
from edtorch.app.rundir import load_config
from edtorch.checkpoint import load_training
from edtorch.interact import Training

Command = Callable[..., Any]
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


@pytest.fixture
def run(command: Command, workplace: Path) -> Path:
    """A short run of two learners."""
    folder = workplace / "run"
    result = command(
        "edtorch-train",
        "experiment=cardea",
        "seeds=2",
        "train.seconds=6",
        "eval.minutes=[0.05]",
        "eval.episodes=3",
        f"hydra.run.dir={folder}",
    )
    assert result.status == 0, result.err
    return folder


def test_summary_figure_and_pictures(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert [e["minutes"] for e in summary["evaluations"]] == pytest.approx([0.05, 0.1])
    assert summary["final"] == summary["evaluations"][-1]
    for evaluation in summary["evaluations"]:
        assert set(evaluation) == FIGURES | {"minutes"}
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
        Training(setup.learner, setup.world, setup.seeds, setup.budget) for _ in range(2)
    )
    load_training(run / "checkpoint.pt", restored)
    anew.advance(300)
    assert restored.clock == anew.clock == 300
    for name in ("model", "policy", "fit", "step"):
        saved, again = getattr(restored.learners, name), getattr(anew.learners, name)
        assert all(torch.equal(saved[key], again[key]) for key in again), name
    result = command("edtorch-eval", f"run={run}", "episodes=2", "yardsticks=true")
    assert result.status == 0, result.err
    (written,) = run.glob("eval_*.json")
    figures = json.loads(written.read_text())
    assert set(figures) > FIGURES
    assert set(figures["yardsticks"]) == {"computed_torque", "pd_gravity", "pd", "nothing"}
    assert figures["yardsticks"]["nothing"]["crash_rate"]["median"] == 1
