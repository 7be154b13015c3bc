"""Studies made of cells: runs of edtorch-train, each made once, in any number of sittings.

    python -m studies.NAME [--cells FILE] [--output FOLDER] [--keep FOLDER] [--only TABLE/CELL ...]
        [--seeds N] [--jobs N] [--quick]

A cell is a folder and the overrides of one run.  A cell whose folder holds a finished run of the
same configuration is done, one that was interrupted is started again, and one that holds anything
else is left alone and named.  ``--quick`` runs the study in minutes, in folders of its own, to see
that it works.

The file of cells:

    seeds: 200                     # optional: of every cell
    common: [KEY=VALUE, ...]       # overrides of all cells; ~KEY leaves a key out
    quick: [KEY=VALUE, ...]        # further overrides of a quick run
    tables:
      TABLE:
        base: [KEY=VALUE, ...]     # optional: overrides of all cells of the table
        baseline: {NAME: [...]}    # optional: the cell that the others are compared with
        cells:
          NAME: [KEY=VALUE, ...]
          NAME: {full: [...], quick: [...], apart: N}

``apart``: one run for each of N seeds, for methods that take one seed or too long for one run.
``{TABLE/NAME}`` in an override stands for the folder of that cell, which is made first.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from edtorch.app.compose import compose
from edtorch.app.errors import ConfigError
from edtorch.app.report import defaults
from edtorch.report.groups import telling
from edtorch.report.runs import CONFIG, SUMMARY, FlatSettings, Unusable, flat, load_run

# The command that a run records: one that a user can type.
TRAIN = "import sys; sys.argv[0] = 'edtorch-train'; from edtorch.app.train import main; main()"
REPORT = "import sys; sys.argv[0] = 'edtorch-report'; from edtorch.app.report import main; main()"
QUICK_APART = 2
"""Most seeds with a run each in a quick run."""
_ANOTHER = re.compile(r"\{([a-z0-9_]+/[a-z0-9_]+)\}")
_OVERRIDE = re.compile(r"~|.*=").match
_NOT_MADE = "not made yet, or failed"


class BadCells(Exception):
    """The file of cells is invalid; the message says where."""


@dataclass(frozen=True)
class Cell:
    """One run: its folder is ``table/name``; overrides: the arguments of edtorch-train."""

    table: str
    name: str
    overrides: tuple[str, ...]
    baseline: bool = False

    @property
    def title(self) -> str:
        return f"{self.table}/{self.name}"

    def folder(self, output: Path) -> Path:
        return output / self.table / self.name


@dataclass(frozen=True)
class Plan:
    """rows: the cells of each row of a table, by ``TABLE/NAME``; second: titles of the cells that
    need another cell first."""

    rows: Mapping[str, Sequence[Cell]]
    second: frozenset[str]

    @property
    def cells(self) -> list[Cell]:
        return [cell for cells in self.rows.values() for cell in cells]


@dataclass(frozen=True)
class Finished:
    """A study whose cells have been run.  missing: why a cell is not there, by its title; keep:
    where the results go, None for nowhere."""

    plan: Plan
    output: Path
    keep: Path | None
    missing: Mapping[str, str]
    quick: bool


def overrides(node: Any, place: str) -> tuple[str, ...]:
    if not isinstance(node, list) or not all(isinstance(v, str) and _OVERRIDE(v) for v in node):
        raise BadCells(f"{place}={node}: expected a list of KEY=VALUE, or ~KEY")
    return tuple(node)


def named(node: Any, place: str) -> dict[str, Any]:
    if not isinstance(node, dict) or not node:
        raise BadCells(f"{place}={node}: expected a mapping with at least one name")
    for name in node:
        if not isinstance(name, str) or not name.replace("_", "").isalnum():
            raise BadCells(f"{place}.{name}: expected a name of letters, digits and _")
    return node


def _check_keys(node: Mapping[str, Any], place: str, *known: str) -> None:
    for key in sorted(node.keys() - set(known)):
        raise BadCells(f"{place}{key}: unknown; expected {', '.join(known)}")


def _count(value: Any, place: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise BadCells(f"{place}={value}: expected an integer >= 1")
    return value


def read_plan(text: str, output: Path, *, quick: bool = False, seeds: int | None = None) -> Plan:
    """The cells, the baseline of each table first.  seeds: instead of those in the file.  Raises
    BadCells."""
    content = named(yaml.safe_load(text), "cells")
    _check_keys(content, "", "seeds", "common", "quick", "tables")
    size = content.get("seeds") if seeds is None else seeds
    many = () if size is None else (f"seeds={_count(size, 'seeds')}",)
    common = overrides(content.get("common", []), "common")
    small = overrides(content.get("quick", []), "quick")
    rows: dict[str, list[Cell]] = {}
    for table, parts in named(content.get("tables"), "tables").items():
        place = f"tables.{table}"
        _check_keys(named(parts, place), f"{place}.", "base", "baseline", "cells")
        base = overrides(parts.get("base", []), f"{place}.base")
        first = named(parts["baseline"], f"{place}.baseline") if "baseline" in parts else {}
        others = named(parts.get("cells"), f"{place}.cells")
        if len(first) > 1 or first.keys() & others.keys():
            raise BadCells(f"{place}.baseline: expected one name that is not among the cells")
        for name, own in {**first, **others}.items():
            full, less, apart = _parts(own, f"{place}.{name}")
            every = (*base, *common, *full, *many, *((*small, *less) if quick else ()))
            if quick and apart is not None:
                apart = min(apart, QUICK_APART)
            rows[f"{table}/{name}"] = [
                Cell(table, f"{name}{tail}", (*every, *more), name in first)
                for tail, more in _runs(apart)
            ]
    filled = {row: [_filled(cell, rows, output) for cell in cells] for row, cells in rows.items()}
    plain = {cell.title: cell for cells in rows.values() for cell in cells}
    second = [c.title for cells in filled.values() for c in cells if c != plain[c.title]]
    return Plan(filled, frozenset(second))


def _parts(own: Any, place: str) -> tuple[tuple[str, ...], tuple[str, ...], int | None]:
    """Overrides, those of a quick run, and the number of seeds with a run each."""
    if not isinstance(own, dict):
        return overrides(own, place), (), None
    _check_keys(own, f"{place}.", "apart", "full", "quick")
    apart = None if "apart" not in own else _count(own["apart"], f"{place}.apart")
    full = overrides(own.get("full"), f"{place}.full")
    return full, overrides(own.get("quick", []), f"{place}.quick"), apart


def _runs(apart: int | None) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Ends of the names, and further overrides, of the runs of a row."""
    if apart is None:
        yield "", ()
    for k in range(apart or 0):
        yield f"/seed_{k}", ("seeds=1", f"seed={k}")


def _filled(cell: Cell, rows: Mapping[str, Sequence[Cell]], output: Path) -> Cell:
    """The cell with the folders of the cells that it names."""

    def folder(match: re.Match[str]) -> str:
        other = rows.get(match[1])
        if other is None or len(other) != 1:
            raise BadCells(f"{cell.title}: {match[0]}: expected a cell with one run")
        return str(other[0].folder(output))

    filled = tuple(_ANOTHER.sub(folder, text) for text in cell.overrides)
    return Cell(cell.table, cell.name, filled, cell.baseline)


def _settings(every: FlatSettings) -> dict[str, Any]:
    """The settings that two runs with the same result share, seeds included.

    A setting that did not exist when a run was made has its default.
    """
    complete = {**defaults(every), **every}
    return telling(complete) | {key: complete.get(key) for key in ("seed", "seeds")}


def wanted(cell: Cell) -> dict[str, Any]:
    """The settings of a cell, complete."""
    config = compose(cell.overrides).plain()
    return _settings(flat(config))


def is_done(folder: Path, settings: dict[str, Any]) -> bool:
    """Whether the folder holds this result.  Raises BadCells if it holds anything that must not be
    replaced: another result, or no run at all."""
    if not folder.exists():
        return False
    try:
        held = _settings(load_run(folder).settings)
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


def python(code: str, arguments: Sequence[str], log: Path | None = None) -> int:
    """Exit status of a process of its own; log: a file for its output."""
    command = [sys.executable, "-c", code, *arguments]
    if log is None:
        return subprocess.run(command).returncode
    with log.open("w", encoding="utf-8") as output:
        return subprocess.run(command, stdout=output, stderr=output).returncode


def _train(cell: Cell, folder: Path) -> int:
    shutil.rmtree(folder, ignore_errors=True)  # of a run that was interrupted
    folder.parent.mkdir(parents=True, exist_ok=True)
    log = folder.with_name(f".{folder.name}.log")
    place = f"hydra.run.dir={folder}"
    status = python(TRAIN, [*cell.overrides, "log.progress=false", place], log)
    print(f"{cell.title}: {'done' if status == 0 else f'exit status {status}, see {log}'}")
    return status


def run(cells: Sequence[Cell], output: Path, jobs: int) -> int:
    """Make the cells that are not there yet; how many failed."""
    due = [cell for cell in cells if not is_done(cell.folder(output), wanted(cell))]
    for cell in cells:
        print(f"{cell.title}: {'to do' if cell in due else 'there'}", flush=True)
    pool = ThreadPoolExecutor(jobs)
    try:
        statuses = list(pool.map(lambda c: _train(c, c.folder(output)), due))
    finally:
        pool.shutdown(cancel_futures=True)  # after Ctrl-C no further cell starts
    return sum(status != 0 for status in statuses)


def _keep(cells: Sequence[Cell], output: Path, folder: Path) -> None:
    """Copy what is committed of each run."""
    for cell in cells:
        there = cell.folder(folder)
        there.mkdir(parents=True, exist_ok=True)
        for name in (CONFIG, SUMMARY):
            shutil.copyfile(cell.folder(output) / name, there / name)


def chosen(cells: Sequence[Cell], only: Sequence[str] | None) -> list[Cell]:
    """The cells with these titles, all if None; a title may stand for all cells below it."""
    if only is None:
        return list(cells)
    for title in only:
        if not any(_is_of(cell, title) for cell in cells):
            known = ", ".join(cell.title for cell in cells)
            raise BadCells(f"--only={title}: expected one of {known}")
    return [cell for cell in cells if any(_is_of(cell, title) for title in only)]


def _is_of(cell: Cell, title: str) -> bool:
    return cell.title == title or cell.title.startswith(f"{title}/")


def _unable(cells: Sequence[Cell]) -> dict[str, str]:
    """Cells that cannot be composed, for instance without their experiment, and why."""
    found: dict[str, str] = {}
    for cell in cells:
        try:
            wanted(cell)
        except ConfigError as error:
            found[cell.title] = str(error).splitlines()[0]
    return found


def _missing(cells: Sequence[Cell], output: Path) -> dict[str, str]:
    """The cells that are not done, and why."""
    missing = _unable(cells)
    for cell in cells:
        if cell.title not in missing:
            try:
                if not is_done(cell.folder(output), wanted(cell)):
                    missing[cell.title] = _NOT_MADE
            except BadCells as error:
                missing[cell.title] = str(error)
    return missing


def main(
    name: str,
    about: str,
    finish: Callable[[Finished], int],
    *,
    output: Path,
    keep: Path | None = None,
) -> None:
    """The command of a study, whose cells are in ``name.yaml``.

    finish: makes reports from the cells that are there; returns how many could not be made.
    """
    parser = argparse.ArgumentParser(description=about)
    default = Path(__file__).with_name(f"{name}.yaml")
    parser.add_argument("--cells", type=Path, default=default)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where the results go")
    parser.add_argument("--only", nargs="+", metavar="TABLE/CELL")
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--jobs", type=int, default=1, help="cells at a time, a core each")
    parser.add_argument("--quick", action="store_true", help="the same in minutes, for a test")
    options = parser.parse_args()
    quick: bool = options.quick
    output = options.output or (output.with_name(f"{output.name}_quick") if quick else output)
    keep = options.keep or (output / "kept" if quick and keep is not None else keep)
    try:
        text = options.cells.read_text(encoding="utf-8")
        plan = read_plan(text, output, quick=quick, seeds=options.seeds)
        cells = chosen(plan.cells, options.only)
        unable = _unable(cells)
        for title, why in unable.items():
            print(f"{title}: cannot be made: {why}")
        able = [cell for cell in cells if cell.title not in unable]
        failed = len(unable)
        for second in (False, True):
            stage = [cell for cell in able if (cell.title in plan.second) is second]
            failed += run(stage, output, options.jobs)
        missing = _missing(plan.cells, output)
        if keep is not None:
            _keep([cell for cell in plan.cells if cell.title not in missing], output, keep)
        failed += finish(Finished(plan, output, keep, missing, quick))
    except (BadCells, OSError) as error:
        sys.exit(f"{name}: {error}")
    except KeyboardInterrupt:
        print(f"{name}: interrupted; the same command goes on", file=sys.stderr)
        sys.exit(130)
    if failed:
        sys.exit(f"{name}: {failed} of {len(cells)} cells failed")
    sys.exit(0)
