"""CSV logs: a line for each sample, a header with names; the state of the next line follows."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from edtorch.run.files import FileProblem
from edtorch.run.plausible import FACTOR
from edtorch.run.recorded import first_rows, last_rows
from edtorch.transitions.candidates import Candidates, followed
from edtorch.transitions.columns import FileColumn, matched, matrix
from edtorch.transitions.units import conversion
from sims.base import Quantity, Spec

GAP = 5.0
"""Medians of the time steps: a longer one is a gap in the log."""


@dataclass(frozen=True)
class Clock:
    """Where a log's time and episodes are.

    time: column of the time stamps, in its unit (default s), None: every step takes the domain's
    dt; episode: column that names each line's episode, None: one; gap: seconds, a longer step is
    no transition, None: GAP medians.
    """

    time: FileColumn | None = None
    episode: str | None = None
    gap: float | None = None


class _Table:
    """The text of a file, by column."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open(encoding="utf-8-sig", newline="") as file:
            try:
                first = file.readline()
                file.seek(0)
                separator = max(",;\t", key=first.count)
                reader = csv.reader(file, delimiter=separator, skipinitialspace=True, strict=True)
                self.names = [name.strip() for name in next(reader, [])]
                self.line: list[int] = []
                self._cells: list[list[str]] = []
                for cells in reader:
                    if not cells:
                        continue
                    if len(cells) != len(self.names):
                        raise FileProblem(
                            f"{path}: line {reader.line_num}: {len(cells)} cells, expected"
                            f" {len(self.names)}, as in the header"
                        )
                    self.line.append(reader.line_num)
                    self._cells.append(cells)
            except (UnicodeDecodeError, csv.Error) as error:
                raise FileProblem(f"{path}: cannot be read as CSV in UTF-8 ({error})") from error
        if not self._cells:
            raise FileProblem(f"{path}: expected a header and at least one line of numbers")

    def text(self, name: str) -> list[str]:
        """The cells of a column."""
        if self.names.count(name) != 1:
            state = "twice or more" if name in self.names else "not"
            raise FileProblem(
                f"{self._path}: column {name!r} is {state} in the header, {', '.join(self.names)}"
            )
        place = self.names.index(name)
        return [cells[place].strip() for cells in self._cells]

    def numbers(self, name: str) -> np.ndarray:
        """The numbers of a column; NaN where a cell is empty."""
        found = np.full(len(self.line), np.nan)
        for row, cell in enumerate(self.text(name)):
            try:
                # Python's own "1_000" is no number of anybody's log.
                found[row] = float(cell.replace("_", "?")) if cell else np.nan
            except ValueError as error:
                raise FileProblem(
                    f"{self._path}: line {self.line[row]}: {name} is {cell!r}, expected a number"
                ) from error
        return found


def from_csv(
    path: Path, spec: Spec, state: list[FileColumn], action: list[FileColumn], clock: Clock
) -> Candidates:
    """A transition from each line to the next one of its episode.  Raises FileProblem."""
    table = _Table(path)

    def named(_: int, quantity: Quantity) -> str:
        return quantity.name

    sources = [
        matched(f"{path}: {kind}", quantities, columns, named)
        for kind, quantities, columns in (
            ("state", spec.state, state),
            ("action", spec.action, action),
        )
    ]
    states, actions = (matrix(table.numbers, each) for each in sources)
    episode = _episodes(path, table, clock.episode)
    last = last_rows(episode)
    dt = np.full(len(states), spec.dt)
    unusable = {"the last line of an episode: no next state": last}
    if clock.time is not None:
        dt = _steps(path, table, clock.time, first_rows(episode), last)
        usual = math.inf if last.all() else float(np.median(dt[~last]))
        if not last.all() and not spec.dt / FACTOR < usual < spec.dt * FACTOR:
            raise FileProblem(
                f"{path}: time: the median step is {usual:g} s, expected less than {FACTOR:g} times"
                f" more or less than the domain's {spec.dt:g}; the stamps' unit is given as t[ms]"
            )
        gap = GAP * usual if clock.gap is None else clock.gap
        if not gap > 0:
            raise FileProblem(f"{path}: gap={gap}: expected a number of seconds > 0")
        unusable[f"a gap in the time stamps (more than {gap:g} s)"] = ~last & (dt > gap)
    elif clock.gap is not None:
        raise FileProblem(f"{path}: gap={clock.gap}: expected none without a column of time stamps")
    return Candidates(
        states,
        actions,
        followed(states),
        dt,
        episode,
        terminated=np.zeros(len(states), dtype=bool),
        unusable=unusable,
        broken=np.zeros(len(states), dtype=bool),
    )


def _episodes(path: Path, table: _Table, name: str | None) -> np.ndarray:
    if name is None:
        return np.zeros(len(table.line), dtype=np.int64)
    labels = table.text(name)
    changes = [True, *(one != other for one, other in pairwise(labels))]
    seen: set[str] = set()
    for row, (label, new) in enumerate(zip(labels, changes, strict=True)):
        if new and label in seen:
            raise FileProblem(
                f"{path}: line {table.line[row]}: episode {label!r} goes on after another one,"
                " expected its lines together"
            )
        seen.add(label)
    return np.cumsum(changes) - 1


def _steps(
    path: Path, table: _Table, time: FileColumn, first: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Seconds from each line to the next one, 0 at the last of an episode."""
    name = time.name if time.source is None else time.source
    unit = time.unit if time.source_unit is None else time.source_unit
    try:
        factor = 1.0 if unit is None else conversion(unit, "s")
    except ValueError as error:
        raise FileProblem(f"{path}: time {name}: {error}") from error
    stamp = table.numbers(name)
    rises = np.append(True, stamp[1:] > stamp[:-1]) | first
    wrong = np.flatnonzero(~rises | ~np.isfinite(stamp))
    if len(wrong):
        row = int(wrong[0])
        before = (
            "a finite number" if first[row] else f"more than {stamp[row - 1]:.17g}, the one before"
        )
        raise FileProblem(
            f"{path}: line {table.line[row]}: time {name} is {stamp[row]:.17g}, expected {before}"
        )
    return np.where(last, 0.0, np.append(np.diff(stamp), 0.0) * factor)
