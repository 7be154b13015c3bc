"""The paper, rerun: its cells, what it says beside what is published, what it names as missing."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from edtorch.app.errors import ConfigError
from edtorch.report.proportions import Proportion
from edtorch.report.runs import load_run
from studies import rerun, rerun_paper
from studies.cells import QUICK_APART, BadCells, Plan, is_done, read_plan, wanted
from studies.footnote_2 import Falls, zero_policy_falls
from studies.rerun_methods import Material, estimates, learnt
from studies.rerun_paper import PUBLISHED, beside, footnote_1, write
from tests.app.conftest import environment
from tests.report.folders import learners, spread
from tests.report.folders import write as write_run

CELLS = Path(rerun.__file__).with_suffix(".yaml")
OUT = Path("out")
REFERENCE = Path(__file__).parents[2] / "runs" / "reference" / "paper"
SMALL = """
common: [log.tensorboard=false]
quick: [compute.native=off]
tables:
  data:
    cells:
      falls: {full: [seeds=4], quick: [seeds=2]}
  methods:
    cells:
      alone: {full: [seeds=9]}
      apart: {apart: 5, full: [train.seconds=7]}
      after: {full: ["offline.data={data/falls}"]}
"""


def test_a_plan() -> None:
    plan = read_plan(SMALL, OUT)
    assert [cell.title for cell in plan.cells] == [
        "data/falls",
        "methods/alone",
        *(f"methods/apart/seed_{k}" for k in range(5)),
        "methods/after",
    ]
    assert plan.cells[3].overrides == (
        "log.tensorboard=false",
        "train.seconds=7",
        "seeds=1",
        "seed=1",
    )
    assert plan.second == {"methods/after"}
    assert plan.cells[-1].overrides[-1] == "offline.data=out/data/falls"


def test_a_quick_plan() -> None:
    plan = read_plan(SMALL, OUT, quick=True)
    falls = plan.cells[0].overrides
    assert falls == ("log.tensorboard=false", "seeds=4", "compute.native=off", "seeds=2")
    assert len(plan.rows["methods/apart"]) == QUICK_APART


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("common:", "comon:", r"^comon: unknown; expected seeds, common, quick"),
        ("{full: [seeds=9]}", "{ful: [seeds=9]}", r"tables\.methods\.alone\.ful: unknown"),
        ("{full: [seeds=9]}", "{quick: [seeds=9]}", r"alone\.full=None: expected a list"),
        ("apart: 5", "apart: 0", r"tables\.methods\.apart\.apart=0: expected an integer >= 1"),
        ("{data/falls}", "{data/rides}", r"methods/after: \{data/rides\}: expected a cell"),
        ("{data/falls}", "{methods/apart}", r"\{methods/apart\}: expected a cell with one run"),
    ],
)
def test_refuses_a_bad_plan(before: str, after: str, why: str) -> None:
    with pytest.raises(BadCells, match=why):
        read_plan(SMALL.replace(before, after), OUT)


def _composed(plan: Plan) -> dict[str, Any]:
    """Of the cells of which there is the experiment."""
    found: dict[str, Any] = {}
    for cell in plan.cells:
        try:
            found[cell.title] = wanted(cell)
        except ConfigError as error:
            assert re.match(r"In 'train': Could not find 'experiment/bicycle_", str(error)), error
    return found


@pytest.mark.long
@pytest.mark.oracle
def test_every_cell_composes_to_a_configuration_of_its_own() -> None:
    full = _composed(read_plan(CELLS.read_text(), OUT))
    assert len({json.dumps(found, sort_keys=True) for found in full.values()}) == len(full)
    for name in ("five_features", "six_features"):
        found = full[f"footnote_1/{name}"]
        assert (found["rival.policies"], found["rival.runs"]) == (100_000, 30)
        assert found["seed"] == 20030512
        assert found["domain.lean_acceleration"] is (name == "six_features")
    assert full["figure_2/bicycle_paper"]["train.seconds"] == 3000
    for name in ("figure_2/bicycle_paper", "methods/bicycle", "methods/bicycle_squared"):
        assert (full[name]["seeds"], full[name]["eval.episodes"]) == (20, 30)
    quick = _composed(read_plan(CELLS.read_text(), OUT, quick=True))
    assert quick.keys() <= full.keys()
    assert all(found["seeds"] <= 2 for found in quick.values())


def test_what_is_published_is_of_rows_that_there_are() -> None:
    rows = {row.partition("/")[2] for row in read_plan(CELLS.read_text(), OUT).rows}
    assert yaml.safe_load(PUBLISHED.read_text())["rows"].keys() <= rows


def test_footnote_1_beside_other_figures() -> None:
    """Holm over the four: by hand 4 p, 3 p, 2 p, p of the sorted ones."""
    here = {
        "five_features": {"goal": Proportion(271, 100_000), "stable": Proportion(205, 100_000)},
        "six_features": {"goal": Proportion(563, 100_000), "stable": Proportion(1008, 100_000)},
    }
    published = yaml.safe_load(PUBLISHED.read_text())["footnote_1"]
    tests = beside(here, published["paper"])
    assert [(t.condition, t.share, t.theirs.count) for t in tests] == [
        ("five_features", "goal", 300),
        ("five_features", "stable", 240),
        ("six_features", "goal", 549),
        ("six_features", "stable", 890),
    ]
    p = sorted(t.p for t in tests)
    assert min(t.adjusted for t in tests) == pytest.approx(4 * p[0])
    assert tests[3].adjusted == pytest.approx(4 * p[0])
    assert max(t.adjusted for t in tests) == pytest.approx(max(p[3], 2 * p[2], 3 * p[1]))
    # z = 118 / sqrt(100,000 * 2 * .00949 * .99051) = 2.7215
    assert tests[3].p == pytest.approx(0.0065, abs=5e-5)
    assert all(test.as_json()["compatible"] for test in beside(here, published["preset"]))
    far = {**here, "six_features": {"goal": Proportion(900, 100_000)}}
    assert not beside(far, published["preset"])[2].as_json()["compatible"]


@pytest.mark.oracle
def test_the_committed_footnote_1() -> None:
    """Of the cells as they stand, 100,000 policies each: the figures of the preset."""
    plan = read_plan(CELLS.read_text(), REFERENCE)
    runs = {row: [load_run(REFERENCE / row)] for row in plan.rows if row.startswith("footnote_1/")}
    for row in runs:
        (cell,) = plan.rows[row]
        assert is_done(cell.folder(REFERENCE), wanted(cell))
    found = footnote_1(Material(runs, {}), yaml.safe_load(PUBLISHED.read_text())["footnote_1"])
    assert found is not None
    assert len(found["preset"]["tests"]) == 4
    assert all(test["p_holm"] > 0.01 for test in found["preset"]["tests"])
    for distance in found["preset"]["distances"].values():
        assert abs(distance["difference_m"]) <= 3


def test_an_untouched_bicycle_falls_after_1_69_seconds() -> None:
    falls = zero_policy_falls(10)
    assert falls.runs == 200
    assert falls.mean_s == pytest.approx(1.688, abs=4 * 0.24 / 200**0.5)
    assert falls.deviation_s == pytest.approx(0.24, abs=0.05)
    told = Falls(100, 1.7, 0.2).as_json()
    assert (told["low_s"], told["high_s"]) == pytest.approx((1.6608, 1.7392), abs=1e-4)


def _search(folder: Path, goal: int, stable: int, distance: float) -> Path:
    config = {"domain": {"_target_": "sims.bicycle.Bicycle"}, "seed": 1}
    total = 100_000
    summary = {
        "seed": 1,
        "goal": {"count": goal, "total": total},
        "stable_not_to_the_goal": {"count": stable, "total": total},
        "median_of_goal_policies": {"path_length_m": distance},
        "wall_s": 100.0,
        "cpu_s": 110.0,
        "command": "edtorch-train experiment=footnote1",
        "versions": {"torch": "2.13.0"},
    }
    return write_run(folder, config, summary)


def _rival(folder: Path, seconds: list[float], never: list[int], seed: int = 0) -> Path:
    seeds = [seed + k for k in range(len(seconds))]
    paid = {
        "seconds": spread(seconds),
        "falls": spread([s / 2 for s in seconds]),
        "cpu_s": spread([s / 50 for s in seconds]),
        "path_length_m": spread([None if s in never else 1001.0 for s in seeds]),
        "never": never,
    }
    first = {"seconds": spread([7.0] * len(seeds)), "episodes": spread([330] * len(seeds))}
    more = {"milestones": {"stable": paid, "goal": paid}, "checkpoints": [first]}
    return learners(folder, [1] * len(seeds), seed=seed, more=more)


def test_seeds_that_have_a_run_each_are_one_row(tmp_path: Path) -> None:
    runs = [
        load_run(_rival(tmp_path / str(k), [10.0 * k], [4] if k == 4 else [], seed=k))
        for k in (4, 2, 3)
    ]
    found = estimates(runs)["milestones.stable.seconds"]
    assert found.sample.lived.tolist() == [20, 30, 40]
    assert found.sample.censored.tolist() == [False, False, True]
    # A third is more than a quarter.
    assert found.middle is None and found.median.value == 30


@pytest.fixture
def paper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Any]:
    """``paper.md`` and ``paper.json`` of a few rows."""
    monkeypatch.setattr(rerun_paper, "zero_policy_falls", lambda episodes: Falls(20, 1.7, 0.2))
    runs = {
        "figure_2/bicycle_paper": [load_run(_rival(tmp_path / "ed", [150, 190, 210, 200], []))],
        "footnote_1/five_features": [load_run(_search(tmp_path / "five", 271, 205, 1006.4))],
        "footnote_1/six_features": [load_run(_search(tmp_path / "six", 563, 1008, 1012.0))],
        "methods/bicycle_pegasus": [load_run(_rival(tmp_path / "p", [900, 950], [0, 1]))],
        "methods/bicycle_sarsa": [],
        "methods/bicycle_lqr": [load_run(learners(tmp_path / "lqr", [3, 4]))],
    }
    missing = {"methods/bicycle_sarsa": "not made yet, or failed"}
    (tmp_path / "figure_3.png").write_text("of a former rerun")
    write(Material(runs, missing), tmp_path, ["figure_2_upper"], quick=False)
    return (tmp_path / "paper.md").read_text(), json.loads((tmp_path / "paper.json").read_text())


def _row(text: str, name: str, which: int) -> list[str]:
    rows = re.findall(rf"^\| {name} \|.*$", text, re.MULTILINE)
    return [cell.strip() for cell in rows[which].strip("|").split("|")]


def test_every_figure_beside_the_published(paper: tuple[str, Any]) -> None:
    text, numbers = paper
    stable, goal = _row(text, "bicycle_paper", 0), _row(text, "bicycle_paper", 1)
    assert stable[:3] == ["bicycle_paper", "4", "4 of 4"]
    assert stable[3].startswith("97.5 [") and stable[4] == "40-60"
    assert stable[5].startswith("195 [") and stable[6] == "about 200"
    # CPU seconds were never published.
    assert stable[7].startswith("3.9 [") and stable[8] == ""
    assert goal[9].startswith("1,001 [") and goal[10] == "near the shortest"
    median = numbers["methods"]["bicycle_paper"]["here"]["milestones.stable.seconds"]["median"]
    assert median["value"] == 195


def test_what_is_not_there_is_said_and_not_invented(paper: tuple[str, Any], tmp_path: Path) -> None:
    text, numbers = paper
    assert not (tmp_path / "figure_3.png").exists()
    assert _row(text, "bicycle_sarsa", 0) == [
        "bicycle_sarsa", "missing", "", "", "1,700 episodes", "", "", "", "",
    ]  # fmt: skip
    assert _row(text, "bicycle_lqr", 0)[2] == "no milestones in its summary"
    # Nobody got there: what was paid is a bound.
    pegasus = _row(text, "bicycle_pegasus", 1)
    assert pegasus[2] == "0 of 2"
    assert pegasus[5] == "KM > 925 (2 of 2 censored)"
    assert pegasus[9] == ""
    assert "* methods/bicycle_sarsa: not made yet, or failed" in text
    assert numbers["missing"]["figure_3"] == "no runs"
    assert "![Length of episode" in text and "figure_3.png" not in text


def test_what_was_paid_while_learning(tmp_path: Path) -> None:
    """Counted by hand; a seed that never got there is none of the median's."""
    path = _rival(tmp_path / "s", [900.0, 950.0, 1000.0], [])
    summary = json.loads((path / "summary.json").read_text())
    goals = {"episodes": [2000, None, 4000], "seconds": [360.0, None, 2520.0]}
    summary |= {
        "falls_before_first_ride": {"per_seed": [1700, 1500, 1600]},
        "never_rode": [2],
        "first_goal": {key: {"per_seed": values} for key, values in goals.items()},
    }
    (path / "summary.json").write_text(json.dumps(summary))
    runs = {"methods/bicycle_sarsa": [load_run(path)], "methods/bicycle_lqr": [load_run(path)]}
    published = {"bicycle_sarsa": {"learning": {"goal": "4,200"}}, "bicycle_lqr": {}}
    found = learnt(Material(runs, {}), published)
    assert found == {
        "bicycle_sarsa": {
            "ride": [1700, 1500, None],
            "goal": [2000, None, 4000],
            "seconds": [360.0, None, 2520.0],
            "published": {"goal": "4,200"},
        }
    }


def test_the_footnotes_are_said_plainly(paper: tuple[str, Any]) -> None:
    text, numbers = paper
    assert "All four shares are compatible (Holm's p > 0.01); six_features: not within 3 m" in text
    six = numbers["footnote_1"]["preset"]["distances"]["six_features"]
    assert (six["difference_m"], six["within_3_m"]) == (4.0, False)
    gradients = numbers["footnote_2"]["gradients"]
    assert [g["simulations"] for g in gradients] == [450, 450, 330]
    assert gradients[0]["seconds"] == pytest.approx(783)
    assert numbers["footnote_2"]["first_checkpoint_of_pegasus"] == {
        "simulations": 330,
        "seconds": 7.0,
    }
    assert "rerun (bicycle_paper): 195 [" in text


@pytest.mark.paper
def test_quick(tmp_path: Path) -> None:
    """All of it, small; and a second time nothing is made again."""
    plan = read_plan(CELLS.read_text(), Path("runs/paper_quick"), quick=True)
    able = set(_composed(plan))

    def rerun() -> str:
        root = str(Path(__file__).parents[2])
        command = [sys.executable, "-m", "studies.rerun", "--quick"]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment() | {"PYTHONPATH": root},
            capture_output=True,
            text=True,
        )
        complete = len(able) == len(plan.cells)
        assert (done.returncode == 0) is complete, done.stdout + done.stderr
        return done.stdout

    out = rerun()
    assert set(re.findall(r"^(\S+): done$", out, re.MULTILINE)) == able
    kept = tmp_path / "runs" / "paper_quick" / "kept"
    numbers = json.loads((kept / "paper.json").read_text())
    assert numbers["quick"] and set(numbers["figures"]) == set(rerun_paper.CAPTIONS)
    assert set(numbers["missing"]) == {cell.title for cell in plan.cells} - able
    for name in numbers["figures"]:
        assert (kept / f"{name}.png").stat().st_size > 10_000
        assert (kept / f"{name}.svg").read_text().startswith("<?xml")
    assert (kept / "report" / "report.html").is_file()
    for name in ("bicycle_paper", "bicycle", "bicycle_squared"):
        assert len(numbers["methods"][name]["here"]) >= 6
    assert ": done" not in rerun()
