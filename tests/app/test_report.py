"""edtorch-report from end to end, and what a user can get wrong."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from edtorch.app import report
from edtorch.report import document
from tests.report.folders import learners, search

Command = Callable[..., Any]
REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
TEXTS = {"report.html", "report.json", "report.md"}
FILES = TEXTS | {
    "bicycle_learners_intervals.png",
    "bicycle_learners_intervals.svg",
    "bicycle_learners_seeds.png",
    "bicycle_learners_seeds.svg",
}


def _names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture
def no_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take most of the time."""
    monkeypatch.setattr(document, "charts", lambda comparison: [])


def _numbers(folder: Path) -> Any:
    return json.loads((folder / "report.json").read_text())


@pytest.fixture
def runs(workplace: Path) -> Path:
    learners(workplace / "runs" / "a", [5, 6, 7])
    learners(workplace / "runs" / "b", [0, 1, 0], eval={"episodes": 3})
    return workplace / "runs"


@pytest.mark.oracle
def test_the_committed_results(command: Command, workplace: Path) -> None:
    """The figures of README's table, from the same summaries."""
    folders = [str(REFERENCE / name) for name in ("bicycle_paper", "bicycle_squared")]
    result = command("edtorch-report", *folders)
    assert result.status == 0, result.err
    assert result.err == ""
    assert _names(workplace / "report") == FILES
    (section,) = _numbers(workplace / "report")["sections"]
    paper, better = section["groups"]
    assert (paper["name"], len(paper["seeds"])) == ("bicycle_paper", 20)
    assert (better["name"], len(better["seeds"])) == ("bicycle_squared", 24)
    for group, median, most in ((paper, 30, 38), (better, 5, 7)):
        falls = group["quantities"]["failures_before_first_success"]
        assert round(falls["median"]["value"]) == median
        assert falls["max"] == most
        assert falls["median"]["low"] <= falls["median"]["value"] <= falls["median"]["high"]
        assert group["shares"]["zero_failure_rate"]["count"] == 0
    before = better["quantities"]["failures_before_first_success"]
    difference = before["difference"]
    assert difference["low"] < difference["value"] < difference["high"] < -15
    better_at_it = better["quantities"]["failures_before_first_success"][
        "probability_of_improvement"
    ]
    assert better_at_it["value"] == 1
    with Image.open(workplace / "report" / "bicycle_learners_seeds.png") as picture:
        assert picture.width > 800


@pytest.mark.experiment
def test_a_run_of_edtorch_train(command: Command, finished: Path, workplace: Path) -> None:
    result = command("edtorch-report", str(finished))
    assert result.status == 0, result.err
    (group,) = _numbers(workplace / "report")["sections"][0]["groups"]
    assert group["seeds"] == [3, 4]
    assert "experiment=bicycle" in group["runs"][0]["command"]


@pytest.mark.oracle
def test_a_sweep(command: Command, runs: Path, workplace: Path) -> None:
    result = command("edtorch-report", "runs", "--output", "out/deep", "--baseline", "b")
    assert result.status == 0, result.err
    assert _names(workplace / "out") == {"deep"}
    content = _numbers(workplace / "out" / "deep")
    assert [group["name"] for group in content["sections"][0]["groups"]] == ["b", "a"]
    assert set(content["files"]) == _names(workplace / "out" / "deep")
    assert content["command"] == "edtorch-report runs --output out/deep --baseline b"
    assert {"python", "edtorch", "torch"} <= content["versions"].keys()
    assert re.search(r"^eval\.episodes=3 .* 66\.7 % \[20\.8, 93\.9\]", result.out, re.MULTILINE)
    assert "report: out/deep/report.html" in result.out


@pytest.mark.usefixtures("no_charts")
def test_the_same_runs_give_the_same_report(command: Command, runs: Path, workplace: Path) -> None:
    contents = []
    for _ in range(2):
        assert command("edtorch-report", "runs").status == 0
        folder = workplace / "report"
        contents.append({p.name: p.read_bytes() for p in folder.iterdir()})
    assert contents[0] == contents[1]


@pytest.mark.usefixtures("no_charts")
def test_a_mixed_bag(command: Command, runs: Path, workplace: Path) -> None:
    """Another domain and a search have sections of their own; the rest is named, with a reason."""
    learners(runs / "arm", [3, 4], domain="sims.cardea.Cardea")
    search(runs / "search", 3, 100)
    learners(runs / "copy", [5, 6, 7])
    shutil.copytree(runs / "a", runs / "half")
    (runs / "half" / "summary.json").write_text('{"seeds": [')
    shutil.copytree(runs / "a", runs / "unfinished")
    (runs / "unfinished" / "status.json").write_text('{"status": "running"}')
    (workplace / "nothing").mkdir()
    result = command("edtorch-report", "runs", "nothing")
    assert result.status == 0, result.err
    content = _numbers(workplace / "report")
    kinds = [(section["domain"], section["kind"]) for section in content["sections"]]
    assert kinds == [("Bicycle", "learners"), ("Cardea", "learners"), ("Bicycle", "searches")]
    reasons = {Path(item["folder"]).name: item["why"] for item in content["left_out"]}
    assert reasons.keys() == {"half", "unfinished", "nothing", "copy"}
    assert "not JSON" in reasons["half"]
    assert "unfinished: status.json says running" in reasons["unfinished"]
    assert "holds no run" in reasons["nothing"]
    assert "counted once" in reasons["copy"]
    page, text = (
        (workplace / "report" / name).read_text() for name in ("report.html", "report.md")
    )
    for name, why in reasons.items():
        assert why in result.err
        assert name in page and name in text
    assert len(result.err.splitlines()) == 4


def test_nothing_to_report(command: Command, workplace: Path) -> None:
    learners(workplace / "runs" / "a", [1])
    (workplace / "runs" / "a" / "summary.json").unlink()
    result = command("edtorch-report", "runs")
    assert result.status == 1
    named, line = result.err.splitlines()
    assert "left out runs/a: unfinished" in named
    assert line == "edtorch-report: runs: expected at least one finished run, found none"
    assert not (workplace / "report").exists()


REFUSED = [
    (["gone"], r"gone: expected a folder with runs, but it does not exist"),
    (["file"], r"file: expected a folder with runs, but it is a file"),
    (["runs", "--baseline", "c"], r"--baseline=c: expected one of a, b"),
    (["runs", "--output", "file"], r"--output=file: expected a folder, but it is a file"),
    (["runs", "--output", "runs"], r"--output=runs: .* but it holds a, which is not of a report"),
    (["runs", "--output", "file/x"], r"file.*: (Not a directory|File exists)"),
]


@pytest.mark.parametrize(("arguments", "why"), REFUSED)
def test_refused(
    command: Command, runs: Path, workplace: Path, arguments: list[str], why: str
) -> None:
    (workplace / "file").write_text("")
    result = command("edtorch-report", *arguments, "--labels", "folders")
    assert result.status == 1
    assert re.search(why, result.line)
    assert _names(workplace) == {"runs", "file"}
    assert _names(runs) == {"a", "b"}


def test_no_folder(command: Command, workplace: Path) -> None:
    result = command("edtorch-report")
    assert result.status == 2
    assert "FOLDER" in result.err


@pytest.mark.usefixtures("no_charts")
class TestOutput:
    def test_a_former_report_is_replaced(
        self, command: Command, runs: Path, workplace: Path
    ) -> None:
        assert command("edtorch-report", "runs").status == 0
        shutil.rmtree(runs / "a")
        assert command("edtorch-report", "runs").status == 0
        assert _names(workplace / "report") == TEXTS
        assert len(_numbers(workplace / "report")["sections"][0]["groups"]) == 1

    def test_what_somebody_put_there_is_kept(
        self, command: Command, runs: Path, workplace: Path
    ) -> None:
        assert command("edtorch-report", "runs").status == 0
        (workplace / "report" / "notes.txt").write_text("mine")
        result = command("edtorch-report", "runs")
        assert result.status == 1
        assert "holds notes.txt, which is not of a report" in result.line
        assert (workplace / "report" / "notes.txt").read_text() == "mine"

    @pytest.mark.parametrize("there_before", [False, True])
    def test_nothing_half_written(
        self,
        command: Command,
        runs: Path,
        workplace: Path,
        monkeypatch: pytest.MonkeyPatch,
        there_before: bool,
    ) -> None:
        if there_before:
            assert command("edtorch-report", "runs").status == 0
        before = {p: p.stat().st_mtime_ns for p in workplace.rglob("*")}

        def no_more(*_: object) -> str:
            raise OSError(28, "No space left on device", "report.html")

        monkeypatch.setattr(report, "html", no_more)
        result = command("edtorch-report", "runs")
        assert result.status == 1
        assert result.line == "edtorch-report: report.html: No space left on device"
        after = {p: p.stat().st_mtime_ns for p in workplace.rglob("*")}
        assert after == before


def test_every_schema_has_defaults() -> None:
    """Of an old configuration that names a bicycle and little else."""
    found = report.defaults({"domain._target_": "sims.bicycle.Bicycle", "inverse.variant": "none"})
    assert found["domain.lean_acceleration"] is False
    assert found["domain.physics.h"] == 0.94
    assert found["rival._target_"] is None
    assert "domain.torque_noise" not in found
    assert "inverse" not in found
    assert "domain" not in found


def test_interrupted(command: Command, runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(report, "compare_all", interrupt)
    result = command("edtorch-report", "runs")
    assert (result.status, result.line) == (130, "edtorch-report: interrupted")
