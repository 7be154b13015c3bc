"""Cells: runs of edtorch-train that are made once, in any number of sittings.

A cell is a folder and the overrides of one run.  One whose folder holds a finished run of the same
configuration is done, one that was interrupted is begun anew, and one that holds anything else is
left alone and named.  ``studies.ablation`` and ``studies.rerun`` are made of such.
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

from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from edtorch.app import schemas
from edtorch.app.report import defaults
from edtorch.report.groups import telling
from edtorch.report.runs import CONFIG, SUMMARY, Settings, Unusable, flat, load

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
    baseline: bool = False

    @property
    def title(self) -> str:
        return f"{self.table}/{self.name}"

    def folder(self, output: Path) -> Path:
        return output / self.table / self.name


def overrides(node: Any, place: str) -> tuple[str, ...]:
    if not isinstance(node, list) or not all(isinstance(v, str) and "=" in v for v in node):
        raise BadCells(f"{place}={node}: expected a list of KEY=VALUE")
    return tuple(node)


def named(node: Any, place: str) -> dict[str, Any]:
    if not isinstance(node, dict) or not node:
        raise BadCells(f"{place}={node}: expected a mapping with at least one name")
    for name in node:
        if not isinstance(name, str) or not name.replace("_", "").isalnum():
            raise BadCells(f"{place}.{name}: expected a name of letters, digits and _")
    return node


def _settings(every: Settings) -> dict[str, Any]:
    """What two runs of one result have in common, seeds included.

    A setting that was not there yet when a run was made has the value that it has by default.
    """
    complete = {**defaults(every), **every}
    return telling(complete) | {key: complete.get(key) for key in ("seed", "seeds")}


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


def python(code: str, arguments: Sequence[str], log: Path | None = None) -> int:
    """Exit status of a process of its own; log: where its output goes, if not to this one's."""
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
    """Make what is not there yet; how many cells failed."""
    due = [cell for cell in cells if not is_done(cell.folder(output), wanted(cell))]
    for cell in cells:
        print(f"{cell.title}: {'to do' if cell in due else 'there'}", flush=True)
    pool = ThreadPoolExecutor(jobs)
    try:
        statuses = list(pool.map(lambda c: _train(c, c.folder(output)), due))
    finally:
        pool.shutdown(cancel_futures=True)  # after Ctrl-C no further cell is begun
    return sum(status != 0 for status in statuses)


def keep(cells: Sequence[Cell], output: Path, folder: Path) -> None:
    """Copy what is committed of each run."""
    for cell in cells:
        there = cell.folder(folder)
        there.mkdir(parents=True, exist_ok=True)
        for name in (CONFIG, SUMMARY):
            shutil.copyfile(cell.folder(output) / name, there / name)


def chosen(cells: Sequence[Cell], only: Sequence[str] | None) -> list[Cell]:
    """Those of these titles, all without any; a title may stand for all cells below it."""
    if only is None:
        return list(cells)
    for title in only:
        if not any(_is_of(cell, title) for cell in cells):
            known = ", ".join(cell.title for cell in cells)
            raise BadCells(f"--only={title}: expected one of {known}")
    return [cell for cell in cells if any(_is_of(cell, title) for title in only)]


def _is_of(cell: Cell, title: str) -> bool:
    return cell.title == title or cell.title.startswith(f"{title}/")


def add_options(parser: argparse.ArgumentParser, cells: Path, output: Path | None) -> None:
    """Those that all commands over cells have."""
    parser.add_argument("--cells", type=Path, default=cells)
    parser.add_argument("--output", type=Path, default=output)
    parser.add_argument("--only", nargs="+", metavar="TABLE/CELL")
    parser.add_argument("--jobs", type=int, default=1, help="cells at a time, a core each")
