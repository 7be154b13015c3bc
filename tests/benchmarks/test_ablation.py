"""The table of the ablation: it reads, its cells compose, what is done is not done again."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore

from benchmarks import ablation
from benchmarks.ablation import CELLS, BadCells, Cell, is_done, read_cells, wanted
from tests.app.conftest import call

LINEAR = """
seeds: 2
common: [domain.dt=0.1, train.seconds=3, eval.episodes=1, log.tensorboard=false, log.figures=false]
tables:
  added:
    base: [domain=linear, reward=quadratic, +reward.state.s0=1, compute.compile=off]
    baseline: {plain: []}
    cells:
      larger_step: [step.alpha=0.7]
"""


@pytest.fixture(autouse=True)
def hydra(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    store = ConfigStore.instance()
    monkeypatch.setattr(store, "repo", {"hydra": store.repo.get("hydra", {})})
    yield


@pytest.mark.oracle
def test_every_cell_composes_to_a_configuration_of_its_own() -> None:
    cells = read_cells(CELLS.read_text())
    found = [json.dumps(wanted(cell), sort_keys=True) for cell in cells]
    tables = [cell.table for cell in cells]
    assert len(set(zip(tables, found, strict=True))) == len(cells)
    assert all(json.loads(settings)["seeds"] >= 200 for settings in found)


def test_cells() -> None:
    plain, larger = read_cells(LINEAR, seeds=5)
    assert plain.title == "added/plain" and plain.baseline
    assert not larger.baseline
    assert larger.overrides[-2:] == ("step.alpha=0.7", "seeds=5")
    assert larger.overrides[:-2] == plain.overrides[:-1]


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("seeds: 2", "seeds: 0", r"seeds=0: expected an integer >= 1"),
        ("seeds: 2", "sedes: 2", r"sedes: unknown; expected seeds, common and tables"),
        ("cells:", "cell:", r"tables\.added\.cell: unknown"),
        ("[step.alpha=0.7]", "step.alpha=0.7", r"tables\.added\.larger_step=.*: expected a list"),
        ("[step.alpha=0.7]", "[step]", r"larger_step=\['step'\]: expected a list of KEY=VALUE"),
        ("larger_step", "../x", r"cells\.\.\./x: expected a name of letters"),
        ("larger_step", "plain", r"baseline: expected one name that is not among the cells"),
        ("{plain: []}", "{}", r"baseline=\{\}: expected a mapping with at least one name"),
    ],
)
def test_refuses_bad_cells(before: str, after: str, why: str) -> None:
    with pytest.raises(BadCells, match=why):
        read_cells(LINEAR.replace(before, after))


class _OneByOne:
    """In place of the pool of threads: a run in this process wants its signals."""

    def __init__(self, _: int) -> None: ...

    def shutdown(self, *, cancel_futures: bool) -> None: ...

    def map(self, function: Callable[[Cell], int], cells: list[Cell]) -> list[int]:
        return [function(cell) for cell in cells]


def _in_this_process(code: str, arguments: list[str], log: Path | None = None) -> int:
    """What ``python -c CODE ARGUMENTS`` would do, without the seconds that it takes to start."""
    name = "edtorch-train" if code == ablation.TRAIN else "edtorch-report"
    return call(name, *arguments).status


@pytest.mark.experiment
def test_runs_what_is_not_there_and_reports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ablation, "ThreadPoolExecutor", _OneByOne)
    monkeypatch.setattr(ablation, "_python", _in_this_process)
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


def test_what_is_no_run_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadCells, match="expected a run or nothing"):
        is_done(tmp_path, {})


def test_an_empty_folder_is_not_done(tmp_path: Path) -> None:
    assert not is_done(tmp_path, wanted(Cell("t", "c", ("experiment=bicycle",), True)))
