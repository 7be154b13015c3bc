"""What each ingredient is worth: added to the paper's settings, and taken from the best.

    python -m studies.ablation [--cells studies/ablation.yaml] [--output runs/ablation]
        [--only TABLE/CELL ...] [--seeds N] [--jobs N] [--keep FOLDER]

Every cell of the tables is one run of edtorch-train with all seeds as one population, in
``OUTPUT/TABLE/CELL``.  A cell whose folder holds a finished run of the same configuration is done,
one that was interrupted is begun anew; so the whole can be stopped and continued.  At the end
edtorch-report writes ``OUTPUT/report_TABLE``.  ``--keep`` copies of each run what is committed: its
configuration and its summary.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml

from studies import cells as making
from studies.cells import REPORT, BadCells, Cell, named, overrides

CELLS = Path(__file__).with_suffix(".yaml")


def read_cells(text: str, seeds: int | None = None) -> list[Cell]:
    """Table by table, the baseline of each first.  seeds: instead of those in the file."""
    content = named(yaml.safe_load(text), "cells")
    unknown = content.keys() - {"seeds", "common", "tables"}
    if unknown:
        raise BadCells(f"{sorted(unknown)[0]}: unknown; expected seeds, common and tables")
    size = content.get("seeds") if seeds is None else seeds
    if not isinstance(size, int) or isinstance(size, bool) or size < 1:
        raise BadCells(f"seeds={size}: expected an integer >= 1")
    common = overrides(content.get("common", []), "common")
    cells: list[Cell] = []
    for table, parts in named(content.get("tables"), "tables").items():
        place = f"tables.{table}"
        unknown = named(parts, place).keys() - {"base", "baseline", "cells"}
        if unknown:
            raise BadCells(
                f"{place}.{sorted(unknown)[0]}: unknown; expected base, baseline and cells"
            )
        base = overrides(parts.get("base"), f"{place}.base")
        first = named(parts.get("baseline"), f"{place}.baseline")
        others = named(parts.get("cells"), f"{place}.cells")
        if len(first) != 1 or first.keys() & others.keys():
            raise BadCells(f"{place}.baseline: expected one name that is not among the cells")
        for name, own in {**first, **others}.items():
            changes = overrides(own, f"{place}.{name}")
            every = (*base, *common, *changes, f"seeds={size}")
            cells.append(Cell(table, name, every, name in first))
    return cells


def report(cells: Sequence[Cell], output: Path) -> int:
    """A report for each table; how many could not be made."""
    failed = 0
    for first in (cell for cell in cells if cell.baseline):
        folders = [cell.folder(output) for cell in cells if cell.table == first.table]
        title = first.table.replace("_", " ").capitalize()
        where = ["--output", str(output / f"report_{first.table}"), "--title", title]
        how = ["--labels", "folders", "--baseline", first.name]
        failed += making.python(REPORT, [*map(str, folders), *where, *how]) != 0
    return failed


def main() -> None:
    parser = argparse.ArgumentParser(description="What each ingredient is worth.")
    making.add_options(parser, CELLS, Path("runs/ablation"))
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    try:
        cells = read_cells(options.cells.read_text(encoding="utf-8"), options.seeds)
        chosen = making.chosen(cells, options.only)
        failed = making.run(chosen, options.output, options.jobs)
    except (BadCells, OSError) as error:
        sys.exit(f"ablation: {error}")
    except KeyboardInterrupt:
        print("ablation: interrupted; the same command goes on", file=sys.stderr)
        sys.exit(130)
    if failed:
        sys.exit(f"ablation: {failed} of {len(chosen)} cells failed")
    if options.only is None:
        failed = report(cells, options.output)
        if options.keep is not None:
            making.keep(cells, options.output, options.keep)
    sys.exit(failed)


if __name__ == "__main__":
    main()
