"""The paper, rerun: its figures, its footnotes, and every method beside the published figures.

    python -m studies.rerun [options: see studies/cells.py]

The cells of ``rerun.yaml`` go to ``runs/paper/TABLE/CELL``.  At the end ``paper.md``,
``paper.json``, the figures and a page of edtorch-report are written into ``runs/reference/paper``
(``--keep``) from the cells that are there, with the configuration and the summary of each; cells
that are not there are named.
"""

from __future__ import annotations

from pathlib import Path

from edtorch.report.runs import load_run
from studies import cells as making
from studies.cells import REPORT, Finished
from studies.rerun_figures import draw
from studies.rerun_methods import Material
from studies.rerun_paper import write

PAGE = "report"


def gather(study: Finished) -> Material:
    """The runs that each row has, and why the others are missing."""
    runs = {
        row: [
            load_run(cell.folder(study.output)) for cell in cells if cell.title not in study.missing
        ]
        for row, cells in study.plan.rows.items()
    }
    return Material(runs, study.missing)


def _page(material: Material, folder: Path) -> int:
    """edtorch-report of all methods; its exit status."""
    there = [str(run.path) for row in material.methods for run in material.runs[row]]
    if not there:
        return 0
    where = ["--output", str(folder / PAGE), "--title", "To ride a bicycle"]
    return making.python(REPORT, [*there, *where, "--labels", "folders"])


def finish(study: Finished) -> int:
    assert study.keep is not None
    material = gather(study)
    write(material, study.keep, draw(material, study.keep), quick=study.quick)
    print(f"written to {study.keep}")
    return int(_page(material, study.keep) != 0)


def main() -> None:
    where = {"output": Path("runs/paper"), "keep": Path("runs/reference/paper")}
    making.main("rerun", "The paper, rerun.", finish, **where)


if __name__ == "__main__":
    main()
