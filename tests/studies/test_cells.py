"""What is done is not done again, and what is not ours is left alone."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from edtorch.app.compose import compose
from studies.cells import BadCells, Cell, chosen, is_done, wanted
from tests.report.folders import learners


def test_what_is_no_run_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(BadCells, match="expected a run or nothing"):
        is_done(tmp_path, {})


def test_an_empty_folder_is_not_done(tmp_path: Path) -> None:
    assert not is_done(tmp_path, wanted(Cell("t", "c", ("experiment=bicycle",), True)))


@pytest.mark.oracle
def test_a_run_from_before_a_setting_was_there_is_done(tmp_path: Path) -> None:
    """It then had the value that is now the default; with another one it is another run."""
    cell = Cell("t", "c", ("experiment=bicycle", "seeds=2"))
    config = compose(cell.overrides).plain()
    del config["train"]["until"], config["observation"], config["schedule"]["every"]
    learners(tmp_path / "run", [0, 1])
    (tmp_path / "run" / "config.yaml").write_text(yaml.safe_dump(config))
    why = r"holds a run with observation\.unwrap=None, the cell has 1\.5"
    with pytest.raises(BadCells, match=why):
        is_done(tmp_path / "run", wanted(cell))
    config["observation"] = {"unwrap": 1.5}
    config["schedule"]["every"] = 16
    (tmp_path / "run" / "config.yaml").write_text(yaml.safe_dump(config))
    assert is_done(tmp_path / "run", wanted(cell))


def test_the_chosen_ones() -> None:
    cells = [Cell("t", name, ("seeds=1",)) for name in ("a", "ab", "b/seed_0", "b/seed_1")]
    assert chosen(cells, None) == cells
    assert [cell.name for cell in chosen(cells, ["t/b", "t/a"])] == ["a", "b/seed_0", "b/seed_1"]
    assert chosen(cells, ["t"]) == cells
    with pytest.raises(BadCells, match=r"--only=t/c: expected one of t/a, t/ab"):
        chosen(cells, ["t/c"])
