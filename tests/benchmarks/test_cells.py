"""What is done is not done again, and what is not ours is left alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.cells import BadCells, Cell, chosen, is_done, wanted


def test_what_is_no_run_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadCells, match="expected a run or nothing"):
        is_done(tmp_path, {})


def test_an_empty_folder_is_not_done(tmp_path: Path) -> None:
    assert not is_done(tmp_path, wanted(Cell("t", "c", ("experiment=bicycle",), True)))


def test_the_chosen_ones() -> None:
    cells = [Cell("t", name, ("seeds=1",)) for name in ("a", "ab", "b/seed_0", "b/seed_1")]
    assert chosen(cells, None) == cells
    assert [cell.name for cell in chosen(cells, ["t/b", "t/a"])] == ["a", "b/seed_0", "b/seed_1"]
    assert chosen(cells, ["t"]) == cells
    with pytest.raises(BadCells, match=r"--only=t/c: expected one of t/a, t/ab"):
        chosen(cells, ["t/c"])
