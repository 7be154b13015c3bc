"""What each ingredient is worth: added to the paper's settings, and taken from the best.

    python -m benchmarks.ablation [--cells benchmarks/ablation.yaml] [--output runs/ablation]
        [--only TABLE/CELL ...] [--seeds N] [--jobs N] [--keep FOLDER]

Every cell of the tables is one run of edtorch-train with all seeds as one population, in
``OUTPUT/TABLE/CELL``.  A cell whose folder holds a finished run of the same configuration is done,
one that was interrupted is begun anew; so the whole can be stopped and continued.  At the end
edtorch-report writes ``OUTPUT/report_TABLE``.  ``--keep`` copies of each run what is committed: its
configuration and its summary.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from edtorch.app import schemas
from edtorch.report.groups import telling
from edtorch.report.runs import CONFIG, SUMMARY, Settings, Unusable, flat, load

CELLS = Path(__file__).with_suffix(".yaml")
# A run says in its folder by which command it was made: the one that anybody can type.
TRAIN = "import sys; sys.argv[0] = 'edtorch-train'; from edtorch.app.train import main; main()"
REPORT = "import sys; sys.argv[0] = 'edtorch-report'; from edtorch.app.report import main; main()"


class BadCells(Exception):
    """The file of cells is not what it should be; the message says where."""


@dataclass(frozen=True)
class Cell:
    """One run: its folder is ``table/name``; overrides: all that edtorch-train is given."""

    table: str
    name: str
    overrides: tuple[str, ...]
    baseline: bool

    @property
    def title(self) -> str:
        return f"{self.table}/{self.name}"


def _overrides(node: Any, place: str) -> tuple[str, ...]:
    if not isinstance(node, list) or not all(isinstance(v, str) and "=" in v for v in node):
        raise BadCells(f"{place}={node}: expected a list of KEY=VALUE")
    return tuple(node)


def _named(node: Any, place: str) -> dict[str, Any]:
    if not isinstance(node, dict) or not node:
        raise BadCells(f"{place}={node}: expected a mapping with at least one name")
    for name in node:
        if not isinstance(name, str) or not name.replace("_", "").isalnum():
            raise BadCells(f"{place}.{name}: expected a name of letters, digits and _")
    return node


def read_cells(text: str, seeds: int | None = None) -> list[Cell]:
    """Table by table, the baseline of each first.  seeds: instead of those in the file."""
    content = _named(yaml.safe_load(text), "cells")
    unknown = content.keys() - {"seeds", "common", "tables"}
    if unknown:
        raise BadCells(f"{sorted(unknown)[0]}: unknown; expected seeds, common and tables")
    size = content.get("seeds") if seeds is None else seeds
    if not isinstance(size, int) or isinstance(size, bool) or size < 1:
        raise BadCells(f"seeds={size}: expected an integer >= 1")
    common = _overrides(content.get("common", []), "common")
    cells: list[Cell] = []
    for table, parts in _named(content.get("tables"), "tables").items():
        place = f"tables.{table}"
        unknown = _named(parts, place).keys() - {"base", "baseline", "cells"}
        if unknown:
            raise BadCells(
                f"{place}.{sorted(unknown)[0]}: unknown; expected base, baseline and cells"
            )
        base = _overrides(parts.get("base"), f"{place}.base")
        first = _named(parts.get("baseline"), f"{place}.baseline")
        others = _named(parts.get("cells"), f"{place}.cells")
        if len(first) != 1 or first.keys() & others.keys():
            raise BadCells(f"{place}.baseline: expected one name that is not among the cells")
        for name, own in {**first, **others}.items():
            changes = _overrides(own, f"{place}.{name}")
            overrides = (*base, *common, *changes, f"seeds={size}")
            cells.append(Cell(table, name, overrides, name in first))
    return cells


def _settings(every: Settings) -> dict[str, Any]:
    """What two runs of one result have in common, seeds included."""
    return telling(every) | {key: every.get(key) for key in ("seed", "seeds")}


def wanted(cell: Cell) -> dict[str, Any]:
    """The settings of a cell, complete."""
    schemas.register()
    with initialize_config_module("conf", version_base="1.3"):
        config = OmegaConf.to_container(compose("train", list(cell.overrides)), resolve=True)
    assert isinstance(config, dict)
    return _settings(flat({str(key): value for key, value in config.items()}))


def is_done(folder: Path, settings: dict[str, Any]) -> bool:
    """Whether the folder holds this result.  Raises BadCells if it holds anything that must not be
    replaced: another result, or no run at all."""
    if not folder.exists():
        return False
    try:
        held = _settings(load(folder).settings)
    except Unusable as error:
        if not (folder / CONFIG).is_file() and any(folder.iterdir()):
            raise BadCells(f"{folder}: expected a run or nothing ({error})") from error
        return False
    for key in sorted(held.keys() | settings.keys()):
        if held.get(key) != settings.get(key):
            raise BadCells(
                f"{folder}: holds a run with {key}={held.get(key)}, the cell has"
                f" {settings.get(key)}; remove it, or choose another --output"
            )
    return True


def _python(code: str, arguments: Sequence[str], log: Path | None = None) -> int:
    """Exit status of a process of its own; log: where its output goes, if not to this one's."""
    command = [sys.executable, "-c", code, *arguments]
    if log is None:
        return subprocess.run(command).returncode
    with log.open("w", encoding="utf-8") as output:
        return subprocess.run(command, stdout=output, stderr=output).returncode


def _train(cell: Cell, folder: Path) -> int:
    shutil.rmtree(folder, ignore_errors=True)  # of a run that was interrupted
    folder.parent.mkdir(parents=True, exist_ok=True)
    log = folder.with_name(f".{cell.name}.log")
    place = f"hydra.run.dir={folder}"
    status = _python(TRAIN, [*cell.overrides, "log.progress=false", place], log)
    print(f"{cell.title}: {'done' if status == 0 else f'exit status {status}, see {log}'}")
    return status


def run(cells: Sequence[Cell], output: Path, jobs: int) -> int:
    """Make what is not there yet; how many cells failed."""
    due = [cell for cell in cells if not is_done(output / cell.table / cell.name, wanted(cell))]
    for cell in cells:
        print(f"{cell.title}: {'to do' if cell in due else 'there'}")
    pool = ThreadPoolExecutor(jobs)
    try:
        statuses = list(pool.map(lambda c: _train(c, output / c.table / c.name), due))
    finally:
        pool.shutdown(cancel_futures=True)  # after Ctrl-C no further cell is begun
    return sum(status != 0 for status in statuses)


def report(cells: Sequence[Cell], output: Path) -> int:
    """A report for each table; how many could not be made."""
    failed = 0
    for first in (cell for cell in cells if cell.baseline):
        folders = [output / cell.table / cell.name for cell in cells if cell.table == first.table]
        title = first.table.replace("_", " ").capitalize()
        where = ["--output", str(output / f"report_{first.table}"), "--title", title]
        how = ["--labels", "folders", "--baseline", first.name]
        failed += _python(REPORT, [*map(str, folders), *where, *how]) != 0
    return failed


def keep(cells: Sequence[Cell], output: Path, folder: Path) -> None:
    """Copy what is committed of each run."""
    for cell in cells:
        there = folder / cell.table / cell.name
        there.mkdir(parents=True, exist_ok=True)
        for name in (CONFIG, SUMMARY):
            shutil.copyfile(output / cell.table / cell.name / name, there / name)


def main() -> None:
    parser = argparse.ArgumentParser(description="What each ingredient is worth.")
    parser.add_argument("--cells", type=Path, default=CELLS)
    parser.add_argument("--output", type=Path, default=Path("runs/ablation"))
    parser.add_argument("--only", nargs="+", metavar="TABLE/CELL")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--jobs", type=int, default=1, help="cells at a time, a core each")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    try:
        cells = read_cells(options.cells.read_text(encoding="utf-8"), options.seeds)
        titles = [cell.title for cell in cells]
        for title in options.only or ():
            if title not in titles:
                raise BadCells(f"--only={title}: expected one of {', '.join(titles)}")
        chosen = [cell for cell in cells if options.only is None or cell.title in options.only]
        failed = run(chosen, options.output, options.jobs)
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
            keep(cells, options.output, options.keep)
    sys.exit(failed)


if __name__ == "__main__":
    main()
