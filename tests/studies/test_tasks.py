"""The study of the standard tasks: its figures, by hand."""

from __future__ import annotations

import math

import pytest
import yaml

from studies import tasks
from studies.cells import read_plan

SUMMARY = {
    "seconds_to_solved": {"per_seed": [4.0, 8.0, None], "median": 8.0, "min": 4.0, "max": None},
    "trials_to_solved": {"per_seed": [1.0, 2.0, None]},
    "success_rate": {"per_seed": [0.97, 1.0, 0.2]},
    "cpu_s_of_trial": [[1.0], [1.0, 2.0], [1.5, 1.0, 3.0]],
    "told": "angles: angle",
}


def test_unsolved_seeds_are_not_within_any_time() -> None:
    assert tasks.within(SUMMARY, 8).count == 2
    assert tasks.within(SUMMARY, 7.9).count == 1
    assert tasks.within(SUMMARY, math.inf).count == 2
    assert tasks.seconds_told(SUMMARY) == "8 [4, ∞]"


def test_a_record_says_what_is_told_and_what_is_published() -> None:
    row = tasks.record_row("cart_pole", SUMMARY, {"within": 4, "published": "9 s"})
    assert row[0] == "cart pole"
    assert row[2].startswith("1 of 3: 33.3 % [")
    assert row[3:] == ["0.97 [0.2]", "1.2", "angles: angle", "9 s"]


def test_an_ablation_counts_after_the_first_trial() -> None:
    row = tasks.ablation_row("own_paths", SUMMARY)
    assert row[1].startswith("1 of 3") and row[2].startswith("2 of 3")


def test_another_method_has_what_it_was_given() -> None:
    given = {"simulated_seconds": [16.0, 16.0, 12.0], "cpu_s": 6.0}
    row = tasks.other_row("cartpole_sac", {**SUMMARY, **given})
    assert row[:2] == ["cartpole sac", "16"]
    assert row[2].startswith("2 of 3: 66.7 % [")
    assert row[3:] == ["8 [4, ∞]", "0.97 [0.2, 1]", "2.0"]


def test_each_row_has_a_cell_of_the_header() -> None:
    given = {"simulated_seconds": [16.0], "cpu_s": 6.0}
    assert len(tasks.other_row("x", {**SUMMARY, **given})) == len(tasks.OTHERS)
    assert len(tasks.record_row("x", SUMMARY, {})) == len(tasks.RECORDS)
    assert len(tasks.ablation_row("x", SUMMARY)) == len(tasks.ABLATION)
    lines = tasks.table(("a", "b"), [["1", "2"]]).splitlines()
    assert lines == ["| a | b |", "| --- | --- |", "| 1 | 2 |"]


def test_what_is_published_belongs_to_cells(tmp_path) -> None:
    content = tasks.PUBLISHED.with_name("tasks.yaml").read_text(encoding="utf-8")
    plan = read_plan(content, tmp_path)
    names = {cell.name for cell in plan.cells if cell.table == "records"}
    published = yaml.safe_load(tasks.PUBLISHED.read_text(encoding="utf-8"))
    assert names == set(published)
    assert all(about["within"] > 0 for about in published.values())


def test_seeds_are_not_those_of_tuning(tmp_path) -> None:
    content = tasks.PUBLISHED.with_name("tasks.yaml").read_text(encoding="utf-8")
    for cell in read_plan(content, tmp_path).cells:
        assert "seed=1000" in cell.overrides


@pytest.mark.parametrize("value", [None, 4.0])
def test_infinity_is_a_sign(value: float | None) -> None:
    found = {"median": value, "min": value, "max": value}
    expected = "∞ [∞, ∞]" if value is None else "4 [4, 4]"
    assert tasks.seconds_told({"seconds_to_solved": found}) == expected
