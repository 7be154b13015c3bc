"""Runs that are killed: when, what their table counts, and ten of the study's own."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path

import pytest

from studies import faults
from studies.cells import wanted
from studies.faults import MOST, QUICK, Fault, Kill, cells_of, moments, table

TEN = [cell.title for cell in cells_of(Path("out"), None, quick=True)]


def test_moments_are_spread_over_the_time_of_learning() -> None:
    drawn = [moments(random.Random(f"{k}"), 10.0) for k in range(2000)]
    assert drawn == [moments(random.Random(f"{k}"), 10.0) for k in range(2000)]
    assert all(each == sorted(each) for each in drawn)
    for count in range(1, MOST + 1):
        assert sum(len(each) == count for each in drawn) == pytest.approx(2000 / MOST, rel=0.1)
    every = sorted(moment for each in drawn for moment in each)
    shares = [every[round(share * len(every))] for share in (0.1, 0.5, 0.9)]
    assert shares == pytest.approx([1.0, 5.0, 9.0], abs=0.3)


def test_a_table_counts_what_was_killed_and_what_is_not_the_same() -> None:
    def one(cell: str, ticks: list[int | None], status: int, different: list[str] | None) -> Fault:
        kills = [Kill(1.0, tick) for tick in ticks]
        return Fault(cell, (), "0", 2.0, "compiled", kills, [], status, different)

    some = [
        one("kernels/a", [None, 0, 7], 0, []),
        one("kernels/b", [0], 0, ["summary.json"]),
        one("torch/a", [9], 1, None),
    ]
    assert [each.same for each in some] == [True, False, False]
    assert table(some).splitlines()[2:] == [
        "| kernels | 2 | 4 | 1, 2 | 2 | 1 |",
        "| torch | 1 | 1 | 0, 0 | 0 | 0 |",
    ]


@pytest.mark.oracle
def test_every_cell_composes_and_there_are_as_many_as_are_wanted() -> None:
    cells = cells_of(Path("out"), None, quick=False)
    counts = {name: sum(cell.table == name for cell in cells) for name in QUICK}
    assert counts == {"kernels": 10, "torch": 10, "cardea": 2, "gymnasium": 2}
    assert len({wanted(cell)["seed"] for cell in cells}) == len(cells)
    assert len(TEN) == 10


@pytest.mark.long
@pytest.mark.parametrize("title", TEN)
def test_killed_runs_are_the_same_runs(
    title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if title.startswith("cardea/"):
        pytest.importorskip("pybullet")
    arguments = ["faults", "--quick", "--only", title, "--output", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    faults.main()
    (run,) = json.loads((tmp_path / "faults.json").read_text())["runs"]
    assert run["kills"] and run["status"] == 0 and run["different"] == []
    computed = {"kernels": "compiled", "torch": "uncompiled"}
    assert run["computed"] == computed.get(title.partition("/")[0], run["computed"])
