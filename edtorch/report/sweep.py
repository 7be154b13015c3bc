"""``sweep.csv``: the jobs of a sweep, what they set and what has become of them."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from edtorch.report.groups import UNSET, telling
from edtorch.report.runs import STATUS, LeftOut, Unusable

SWEEP = "sweep.csv"
FOLDER, STATE, HEADLINE = "folder", "status", "headline"
"""Columns: settings stand between the second and the third, results from there on."""
DONE = "done"


@dataclass(frozen=True)
class SweepJob:
    """folder: None where the job has not begun; why: it is not done; settings: by key, as typed."""

    folder: Path | None
    status: str
    why: str
    settings: Mapping[str, str]


@dataclass(frozen=True)
class SweepTable:
    """The jobs in a sweep's folder."""

    folder: Path
    jobs: tuple[SweepJob, ...]

    @property
    def name(self) -> str:
        """Of the sweep."""
        return self.folder.resolve().name

    @property
    def unfinished(self) -> list[SweepJob]:
        """Those without a result."""
        return [job for job in self.jobs if job.status != DONE]


def read_sweep(folder: Path) -> SweepTable:
    """The table of the sweep in ``folder``, and what its jobs say of themselves today.

    Raises Unusable.
    """
    path = folder / SWEEP
    try:
        with path.open(newline="", encoding="utf-8") as file:
            table = csv.DictReader(file, strict=True)
            columns = list(table.fieldnames or ())
            rows = list(table)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise Unusable(f"corrupted: {SWEEP} cannot be read ({error})") from error
    if columns[:2] != [FOLDER, STATE] or any(None in row or None in row.values() for row in rows):
        raise Unusable(f"corrupted: {SWEEP}: expected rows of {FOLDER}, {STATE} and settings")
    end = columns.index(HEADLINE) if HEADLINE in columns else len(columns)
    return SweepTable(folder, tuple(_job(folder, row, columns[2:end]) for row in rows))


def _job(sweep: Path, row: Mapping[str, str], keys: Sequence[str]) -> SweepJob:
    settings = {key: row[key] for key in keys}
    if not row[FOLDER]:
        return SweepJob(None, row[STATE], "", settings)
    folder = sweep / row[FOLDER]
    try:
        told = json.loads((folder / STATUS).read_text(encoding="utf-8"))
        status, why = str(told["status"]), " ".join(str(told.get("why") or "").split())
    except (OSError, ValueError, LookupError, TypeError):
        status, why = row[STATE], ""
    return SweepJob(folder, status, why, settings)


def sweeps_in(folders: Sequence[Path]) -> tuple[list[SweepTable], list[LeftOut]]:
    """Those in and under these folders, each once, and those that cannot be read."""
    found: dict[Path, SweepTable] = {}
    left_out: list[LeftOut] = []
    for folder in folders:
        for place, inside, files in os.walk(folder):
            inside[:] = sorted(name for name in inside if not name.startswith("."))
            if SWEEP in files and Path(place).resolve() not in found:
                try:
                    found[Path(place).resolve()] = read_sweep(Path(place))
                except Unusable as error:
                    left_out.append(LeftOut(Path(place), str(error)))
    return list(found.values()), left_out


@dataclass(frozen=True)
class Axis:
    """A setting that a sweep varies; values: in order."""

    key: str
    values: tuple[str, ...]


def varied(jobs: Sequence[SweepJob]) -> list[Axis]:
    """What these jobs set differently."""
    found: list[Axis] = []
    for key in dict.fromkeys(key for job in jobs for key in job.settings):
        values = dict.fromkeys(job.settings.get(key) or UNSET for job in jobs)
        if len(values) > 1:
            found.append(Axis(key, tuple(_in_order(list(values)))))
    return found


def axes_of(jobs: Sequence[SweepJob]) -> list[Axis]:
    """What these jobs set differently, but for what changes no figure, such as seeds."""
    known = {axis.key: axis for axis in varied(jobs)}
    return [known[key] for key in telling(known)]


def _in_order(values: list[str]) -> list[str]:
    """Numbers by size; anything else as it came."""
    try:
        return sorted(values, key=float)
    except ValueError:
        return values
