"""The paper, rerun: its figures, its footnotes, and every method beside the published figures.

    python -m studies.rerun [--quick] [--cells studies/rerun.yaml] [--output runs/paper]
        [--keep runs/reference/paper] [--only TABLE/CELL ...] [--jobs N]

Every cell is one run of edtorch-train in ``OUTPUT/TABLE/CELL``, made by the command that its
summary names; what is done is not done again, so that the whole can be stopped and continued.  At
the end ``paper.md``, ``paper.json``, the figures and a page of edtorch-report are written into
``KEEP`` from the cells that there are, with the configuration and the summary of each; cells that
are not there are named.  ``--quick`` is the same in minutes, to see that it works: its figures mean
nothing, and it has folders of its own.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from hydra.errors import HydraException

from edtorch.report.runs import Run, load
from studies import cells as making
from studies.cells import REPORT, BadCells, Cell, named, overrides
from studies.rerun_figures import draw
from studies.rerun_material import Material
from studies.rerun_paper import write

CELLS = Path(__file__).with_suffix(".yaml")
QUICK_APART = 2
"""Seeds with a run each in a quick run, at most."""
ANOTHER = re.compile(r"\{([a-z0-9_]+/[a-z0-9_]+)\}")
"""In an override: the folder of another cell."""
PAGE = "report"


@dataclass(frozen=True)
class Plan:
    """first: cells that need no other; then: those that do; rows: of each row of a table, by
    ``TABLE/NAME``, its cells."""

    first: list[Cell]
    then: list[Cell]
    rows: dict[str, list[Cell]]

    @property
    def cells(self) -> list[Cell]:
        return [*self.first, *self.then]


def read_plan(text: str, output: Path, *, quick: bool) -> Plan:
    """Raises BadCells, which says where."""
    content = named(yaml.safe_load(text), "cells")
    _check_keys(content, {"common", "quick", "tables"}, "")
    common = overrides(content.get("common", []), "common")
    all_quick = overrides(content.get("quick", []), "quick")
    plan = Plan([], [], {})
    for table, rows in named(content.get("tables"), "tables").items():
        for name, parts in named(rows, f"tables.{table}").items():
            place = f"tables.{table}.{name}"
            _check_keys(named(parts, place), {"full", "quick", "apart"}, f"{place}.")
            every = (*overrides(parts.get("full"), f"{place}.full"), *common)
            small = overrides(parts.get("quick", []), f"{place}.quick")
            if quick:
                every += (*all_quick, *small)
            cells = _apart(table, name, parts.get("apart"), every, place, quick=quick)
            plan.rows[f"{table}/{name}"] = cells
    for cell in [cell for cells in plan.rows.values() for cell in cells]:
        filled, needs = _filled(cell, plan.rows, output)
        (plan.then if needs else plan.first).append(filled)
    return plan


def _check_keys(node: Mapping[str, Any], known: set[str], place: str) -> None:
    for key in sorted(node.keys() - known):
        raise BadCells(f"{place}{key}: unknown; expected {', '.join(sorted(known))}")


def _apart(
    table: str, name: str, apart: Any, every: tuple[str, ...], place: str, *, quick: bool
) -> list[Cell]:
    """A cell, or one for each seed."""
    if apart is None:
        return [Cell(table, name, every)]
    if not isinstance(apart, int) or isinstance(apart, bool) or apart < 1:
        raise BadCells(f"{place}.apart={apart}: expected an integer >= 1")
    size = min(apart, QUICK_APART) if quick else apart
    return [Cell(table, f"{name}/seed_{k}", (*every, "seeds=1", f"seed={k}")) for k in range(size)]


def _filled(cell: Cell, rows: Mapping[str, list[Cell]], output: Path) -> tuple[Cell, bool]:
    """With the folders of the cells that it names; whether there are such."""

    def folder(match: re.Match[str]) -> str:
        other = rows.get(match[1])
        if other is None or len(other) != 1:
            raise BadCells(f"{cell.title}: {match[0]}: expected a cell with one run")
        return str(other[0].folder(output))

    filled = tuple(ANOTHER.sub(folder, text) for text in cell.overrides)
    return Cell(cell.table, cell.name, filled), filled != cell.overrides


def _unable(cells: Sequence[Cell]) -> dict[str, str]:
    """Cells that cannot be composed, such as those of an experiment that is not there, and why."""
    found: dict[str, str] = {}
    for cell in cells:
        try:
            making.wanted(cell)
        except HydraException as error:
            found[cell.title] = str(error).splitlines()[0]
    return found


def gather(plan: Plan, output: Path) -> Material:
    """What there is of each row, and why there is not what is not."""
    runs: dict[str, list[Run]] = {}
    missing = _unable(plan.cells)
    filled = {cell.title: cell for cell in plan.cells}
    for row, cells in plan.rows.items():
        runs[row] = []
        for cell in (filled[own.title] for own in cells):
            if cell.title in missing:
                continue
            try:
                if making.is_done(cell.folder(output), making.wanted(cell)):
                    runs[row].append(load(cell.folder(output)))
                else:
                    missing[cell.title] = "not made yet, or failed"
            except BadCells as error:
                missing[cell.title] = str(error)
    return Material(runs, missing)


def _page(material: Material, folder: Path) -> int:
    """edtorch-report of all methods; status."""
    there = [str(run.path) for row in material.methods for run in material.runs[row]]
    if not there:
        return 0
    where = ["--output", str(folder / PAGE), "--title", "To ride a bicycle"]
    return making.python(REPORT, [*there, *where, "--labels", "folders"])


def main() -> None:
    parser = argparse.ArgumentParser(description="The paper, rerun.")
    making.add_options(parser, CELLS, None)
    parser.add_argument("--quick", action="store_true", help="the same in minutes, for a test")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where the results go")
    options = parser.parse_args()
    output = options.output or Path("runs/paper_quick" if options.quick else "runs/paper")
    folder = options.keep or (output / "kept" if options.quick else Path("runs/reference/paper"))
    try:
        plan = read_plan(options.cells.read_text(encoding="utf-8"), output, quick=options.quick)
        chosen = making.chosen(plan.cells, options.only)
        unable = _unable(chosen)
        for title, why in unable.items():
            print(f"{title}: cannot be made: {why}")
        able = [cell for cell in chosen if cell.title not in unable]
        failed = len(unable)
        for stage in (plan.first, plan.then):
            failed += making.run([c for c in able if c in stage], output, options.jobs)
        material = gather(plan, output)
        done = [cell for cell in plan.cells if cell.title not in material.missing]
        making.keep(done, output, folder)
        drawn = draw(material, folder)
        write(material, folder, drawn, quick=options.quick)
        failed += _page(material, folder) != 0
    except (BadCells, OSError) as error:
        sys.exit(f"rerun: {error}")
    except KeyboardInterrupt:
        print("rerun: interrupted; the same command goes on", file=sys.stderr)
        sys.exit(130)
    print(f"written to {folder}")
    if failed:
        sys.exit(f"rerun: {failed} of {len(chosen)} cells failed")


if __name__ == "__main__":
    main()
