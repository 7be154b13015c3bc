"""Runs made before the packages (commit 36301f2) can still be evaluated and reported.

``older_runs`` holds one run of each kind, without checkpoints, and in ``evaluation.json`` what
``edtorch-eval`` of that commit found with two episodes of the given domain setting.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.app.conftest import call

RUNS = Path(__file__).with_name("older_runs")
GONE = {"goal_rate", "fall_rate"}
"""Keys that a domain without a goal, or with other words than the bicycle's, no longer has."""


@pytest.mark.experiment
@pytest.mark.parametrize("name", sorted(p.name for p in RUNS.iterdir()))
def test_evaluation_finds_what_it_found_then(name: str, tmp_path: Path) -> None:
    if name == "cardea":
        pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")
    shutil.copytree(RUNS / name, tmp_path / name)
    then = json.loads((RUNS / name / "evaluation.json").read_text())
    result = call("edtorch-eval", f"run={tmp_path / name}", "episodes=2", then["override"])
    assert result.status == 0, result.err
    (path,) = (tmp_path / name).glob("eval_*.json")
    now = json.loads(path.read_text())
    missing = {key for key in then["figures"] if key not in now}
    assert missing <= GONE and "failure_rate" in now
    for key in then["figures"].keys() - missing:
        assert now[key]["per_seed"] == pytest.approx(then["figures"][key], rel=1e-6), key
    if "fall_rate" in missing:
        assert now["failure_rate"]["per_seed"] == then["figures"]["fall_rate"]


@pytest.mark.experiment
def test_the_report_reads_them(tmp_path: Path) -> None:
    shutil.copytree(RUNS, tmp_path / "runs")
    result = call("edtorch-report", str(tmp_path / "runs"), f"--output={tmp_path / 'out'}")
    assert result.status == 0, result.err
    page = next((tmp_path / "out").rglob("report.html")).read_text()
    for name in ("bicycle", "figure1", "cardea"):
        assert name in page
