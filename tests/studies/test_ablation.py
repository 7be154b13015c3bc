"""The table of the ablation: it reads, its cells compose, what is done is not done again."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from studies import ablation
from studies.cells import BadCells, read_plan, wanted
from tests.studies.in_process import in_this_process

CELLS = Path(ablation.__file__).with_suffix(".yaml")
LINEAR = """
seeds: 2
common: [domain.dt=0.1, train.seconds=3, eval.episodes=1, log.tensorboard=false, log.figures=false]
tables:
  added:
    base: [domain=linear, reward=quadratic, +reward.state.state_0=1, compute.native=off]
    baseline: {plain: []}
    cells:
      larger_step: [step.alpha=0.7]
"""


@pytest.mark.oracle
def test_every_cell_composes_to_a_configuration_of_its_own() -> None:
    cells = read_plan(CELLS.read_text(), Path("out")).cells
    found = [json.dumps(wanted(cell), sort_keys=True) for cell in cells]
    tables = [cell.table for cell in cells]
    assert len(set(zip(tables, found, strict=True))) == len(cells)
    assert all(json.loads(settings)["seeds"] >= 200 for settings in found)


def test_cells() -> None:
    plain, larger = read_plan(LINEAR, Path("out"), seeds=5).cells
    assert plain.title == "added/plain" and plain.baseline
    assert not larger.baseline
    assert larger.overrides[-2:] == ("step.alpha=0.7", "seeds=5")
    assert larger.overrides[:-2] == plain.overrides[:-1]


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("seeds: 2", "seeds: 0", r"seeds=0: expected an integer >= 1"),
        ("seeds: 2", "sedes: 2", r"sedes: unknown; expected seeds, common, quick, tables"),
        ("cells:", "cell:", r"tables\.added\.cell: unknown"),
        ("[step.alpha=0.7]", "step.alpha=0.7", r"tables\.added\.larger_step=.*: expected a list"),
        ("[step.alpha=0.7]", "[step]", r"larger_step=\['step'\]: expected a list of KEY=VALUE"),
        ("larger_step", "../x", r"cells\.\.\./x: expected a name of letters"),
        ("larger_step", "plain", r"baseline: expected one name that is not among the cells"),
        ("{plain: []}", "{}", r"baseline=\{\}: expected a mapping with at least one name"),
        ("{plain: []}", "{a: [], b: []}", r"baseline: expected one name that is not among the"),
    ],
)
def test_refuses_bad_cells(before: str, after: str, why: str) -> None:
    with pytest.raises(BadCells, match=why):
        read_plan(LINEAR.replace(before, after), Path("out"))


@pytest.mark.long
@pytest.mark.experiment
def test_runs_what_is_not_there_and_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    in_this_process(monkeypatch)
    Path("cells.yaml").write_text(LINEAR)

    def ablate(*arguments: str) -> object:
        monkeypatch.setattr(sys, "argv", ["ablation", "--cells", "cells.yaml", *arguments])
        with pytest.raises(SystemExit) as left:
            ablation.main()
        return left.value.code

    assert ablate("--keep", "kept") == 0
    assert "added/plain: to do" in capfd.readouterr().out
    (section,) = json.loads(Path("runs/ablation/report_added/report.json").read_text())["sections"]
    assert [group["label"] for group in section["groups"]] == ["plain", "larger_step"]
    command = section["groups"][1]["runs"][0]["command"]
    assert command.startswith("edtorch-train domain=linear")
    assert {path.name for path in Path("kept/added/plain").iterdir()} == {
        "config.yaml",
        "summary.json",
    }
    # Interrupted: begun anew.  Done: left alone.  Another configuration: refused.
    plain, larger = (Path("runs/ablation/added") / name for name in ("plain", "larger_step"))
    status = json.loads((larger / "status.json").read_text())
    (larger / "status.json").write_text(json.dumps(status | {"status": "interrupted"}))
    stamp = (plain / "summary.json").stat().st_mtime_ns
    assert ablate() == 0
    out = capfd.readouterr().out
    assert "added/plain: there" in out and "added/larger_step: to do" in out
    assert (plain / "summary.json").stat().st_mtime_ns == stamp
    assert json.loads((larger / "status.json").read_text())["status"] == "done"
    assert ablate("--seeds", "3") == (
        f"ablation: {plain}: holds a run with seeds=2, the cell has 3; remove it, or choose another"
        " --output"
    )
    assert "--only=added/x: expected one of added/plain" in str(ablate("--only", "added/x"))
