"""Checkpoints in a summary; milestones in the tables and figures of a report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from edtorch.report.charts import charts
from edtorch.report.comparison import Comparison, compare_all
from edtorch.report.document import document, milestone_tables
from edtorch.report.domain import Domain
from edtorch.report.groups import sections
from edtorch.report.html import html
from edtorch.report.milestones import checkpoint_figures
from edtorch.report.runs import load_all
from edtorch.run.milestones import Checkpoint
from sims.bicycle.bicycle import PATH_LENGTH, WORDS
from tests.report.folders import learners, spread


def at(seconds: float, fall_rate: float, goal_rate: float) -> Checkpoint:
    paid = (seconds, int(seconds), int(seconds) // 2, seconds / 10)
    return Checkpoint(*paid, 30, fall_rate, goal_rate)


BICYCLE = Domain("bicycle", WORDS, (PATH_LENGTH,), survival=True)
HISTORY = [
    [at(10, 1, 0), at(20, 0, 0.5), at(30, 0, 1)],
    [at(10, 0.5, 0), at(25, 0.1, 0.9)],
    [at(10, 0, 1)],
]


def test_checkpoints_stand_beside_each_other() -> None:
    found = checkpoint_figures(HISTORY, BICYCLE)
    assert [c["seconds"]["per_seed"] for c in found] == [
        [10, 10, 10],
        [20, 25, None],
        [30, None, None],
    ]
    assert found[1]["failure_rate"]["per_seed"] == [0, 0.1, None]
    assert found[1]["fall_rate"] == found[1]["failure_rate"]


def told(stable: list[float], goal: list[float], never: list[int]) -> dict[str, Any]:
    """Of a summary: what was paid, falls a tenth of the seconds; never: seeds without the goal."""

    def paid(seconds: list[float], lost: list[int]) -> dict[str, Any]:
        return {
            "seconds": spread(seconds),
            "falls": spread([s / 10 for s in seconds]),
            "episodes": spread([s / 5 for s in seconds]),
            "cpu_s": spread([s / 100 for s in seconds]),
            "path_length_m": spread(
                [None if k in lost else 1000.0 + k for k in range(len(seconds))]
            ),
            "never": lost,
        }

    return {"milestones": {"stable": paid(stable, []), "goal": paid(goal, never)}}


@pytest.fixture
def comparison(tmp_path: Path) -> Comparison:
    learners(tmp_path / "a", [0] * 5, more=told([10, 20, 30, 40, 50], [60, 70, 80, 90, 100], []))
    slow = told([100] * 5, [500, 600, 700, 800, 900], [3, 4])
    learners(tmp_path / "b", [1] * 5, more=slow, train={"slow": True})
    learners(tmp_path / "c", [2] * 5, train={"slow": "without"})
    runs, left_out = load_all([tmp_path], lambda _: BICYCLE)
    assert left_out == []
    found, _ = sections(runs, lambda _: {}, baseline="a", by_folder=True)
    (comparison,) = compare_all(found)
    return comparison


def test_the_table_of_milestones(comparison: Comparison) -> None:
    (table,) = milestone_tables(comparison)
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert rows["a"]["to a stable policy: simulated seconds"].startswith("30 [")
    assert rows["a"]["to the goal: simulated seconds"].startswith("80 [")
    assert "of 5" not in rows["a"]["to the goal: falls"]
    # Two of five are more than a quarter: Kaplan and Meier's median, the third of five.
    assert rows["b"]["to the goal: simulated seconds"].startswith("KM 700 [")
    assert "(2 of 5 censored)" in rows["b"]["to the goal: simulated seconds"]
    # The path of those who got there: the middle one of three.
    assert rows["b"]["to the goal: length of path, m"].startswith("1,001 [")
    assert set(list(rows["c"].values())[2:]) == {"-"}


def test_the_chart_of_milestones_and_the_page(comparison: Comparison) -> None:
    chart = next(c for c in charts(comparison) if c.name == "bicycle_learners_milestones")
    titles = [axes.get_title() for axes in chart.draw(9.0).axes if axes.get_title()]
    assert [title.replace("\n", " ") for title in titles] == [
        "falls to a stable policy",
        "simulated seconds to a stable policy",
        "CPU seconds to a stable policy",
        "falls to the goal",
        "simulated seconds to the goal",
        "CPU seconds to the goal",
        "length of path, m: the first policy at the goal",
    ]
    page = html(document([comparison], [], "title", "made"))
    assert "Bicycle: learners, milestones" in page
    assert "paid to a stable policy and to the goal" in page


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"milestones": []}, "milestones: expected figures by name"),
        ({"milestones": {"goal": {"never": [99]}}}, "milestones.goal.never: expected some of its"),
        ({"milestones": {"goal": {}}}, "milestones.goal.never: expected some of its seeds"),
        (
            {"milestones": {"goal": {"never": [], "falls": {"per_seed": [1]}}}},
            "milestones.goal.falls.per_seed: expected 2 figures",
        ),
    ],
)
def test_what_is_no_milestone_is_named(tmp_path: Path, change: dict[str, Any], why: str) -> None:
    learners(tmp_path / "a", [1, 2], more=change)
    _, (left,) = load_all([tmp_path])
    assert f"corrupted: summary.json: {why}" in left.why


def test_runs_without_milestones_have_no_table(tmp_path: Path) -> None:
    learners(tmp_path / "a", [1, 2])
    found, _ = sections(load_all([tmp_path])[0], lambda _: {}, baseline=None, by_folder=True)
    assert milestone_tables(compare_all(found)[0]) == []
