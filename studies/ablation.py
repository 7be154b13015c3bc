"""What each ingredient is worth: added to the paper's settings, and removed from the best.

    python -m studies.ablation [options: see studies/cells.py]

Every cell of ``ablation.yaml`` is one run of edtorch-train with all seeds as one population, in
``runs/ablation/TABLE/CELL``.  At the end edtorch-report writes ``runs/ablation/report_TABLE`` from
the cells that are there.  ``--keep`` copies the configuration and the summary of each run.
"""

from __future__ import annotations

from pathlib import Path

from studies import cells as making
from studies.cells import REPORT, Finished


def report(study: Finished) -> int:
    """A report for each table whose baseline is there; how many could not be made."""
    failed = 0
    there = [cell for cell in study.plan.cells if cell.title not in study.missing]
    for first in (cell for cell in there if cell.baseline):
        folders = [str(cell.folder(study.output)) for cell in there if cell.table == first.table]
        title = first.table.replace("_", " ").capitalize()
        where = ["--output", str(study.output / f"report_{first.table}"), "--title", title]
        how = ["--labels", "folders", "--baseline", first.name]
        failed += making.python(REPORT, [*folders, *where, *how]) != 0
    return failed


def main() -> None:
    about = "What each ingredient is worth."
    making.main("ablation", about, report, output=Path("runs/ablation"))


if __name__ == "__main__":
    main()
