"""What has become of the jobs of a sweep: ``sweep.csv``, and the table of those not done."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edtorch.app.lock import Lock
from edtorch.app.rundir import STATUS, SUMMARY
from edtorch.app.summary import medians
from edtorch.app.sweep_job import overrides_of
from edtorch.app.sweep_names import key_of
from edtorch.app.sweep_record import JOB
from edtorch.app.work import headline
from edtorch.report.sweep import FOLDER, HEADLINE, STATE, SWEEP
from edtorch.run.files import write_text


@dataclass(frozen=True)
class Outcome:
    """Of one job.  folder: None where it has not begun; status: done, failed, interrupted, running
    (in another process), unfinished (it has ended without a result) or not begun; why: in one line,
    may be empty."""

    overrides: tuple[str, ...]
    folder: Path | None = None
    status: str = "not begun"
    why: str = "nothing has started it"

    @property
    def settings(self) -> dict[str, str]:
        """By what its overrides set."""
        return {key_of(override): override.partition("=")[2] for override in self.overrides}

    def results(self) -> dict[str, float]:
        """The figure that sweepers minimise, and the medians over the seeds; none unless done."""
        if self.folder is None or self.status != "done":
            return {}
        summary = json.loads((self.folder / SUMMARY).read_text(encoding="utf-8"))
        return {HEADLINE: headline(summary), **medians(summary)}


def outcomes(sweep: Path, planned: Sequence[Sequence[str]]) -> list[Outcome]:
    """Of the jobs that were planned, in order, and of any others that the folder holds.

    planned: their overrides, as far as they are known beforehand.
    """
    found = {tuple(overrides_of(folder)): folder for folder in _folders(sweep)}
    jobs = dict.fromkeys([*map(tuple, planned), *found])
    return [_outcome(job, found[job]) if job in found else Outcome(job) for job in jobs]


def _folders(sweep: Path) -> Iterator[Path]:
    for place, folders, files in os.walk(sweep):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if JOB in files:
            yield Path(place)


def _outcome(overrides: tuple[str, ...], folder: Path) -> Outcome:
    try:
        told = json.loads((folder / STATUS).read_text(encoding="utf-8"))
        status, why = told["status"], " ".join((told.get("why") or "").split())
    except (OSError, ValueError, LookupError, TypeError):
        status, why = "running", ""
    if status == "running" and (process := Lock(folder).other()) is not None:
        why = f"in use by {process}"
    elif status == "running":
        status, why = "unfinished", "ended without a result"
    return Outcome(overrides, folder, status, why)


def write_csv(sweep: Path, jobs: Sequence[Outcome]) -> Path:
    """One row for each job: folder, status, settings (first those in which jobs differ), results.

    Returns the file.
    """
    differing = differing_keys(jobs)
    others = [key for job in jobs for key in job.settings if key not in differing]
    results = [job.results() for job in jobs]
    figures = [name for each in results for name in each]
    columns = dict.fromkeys([FOLDER, STATE, *differing, *others, *figures])
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    for job, found in zip(jobs, results, strict=True):
        own: dict[str, Any] = {FOLDER: _below(sweep, job.folder), STATE: job.status}
        table.writerow({**own, **job.settings, **found})
    write_text(sweep / SWEEP, text.getvalue())
    return sweep / SWEEP


def differing_keys(jobs: Sequence[Outcome]) -> list[str]:
    """What the jobs set differently."""
    settings = [job.settings for job in jobs]
    keys = dict.fromkeys(key for each in settings for key in each)
    return [key for key in keys if len({each.get(key) for each in settings}) > 1]


def _below(sweep: Path, folder: Path | None) -> str:
    return "" if folder is None else str(folder.relative_to(sweep))


def table_of(sweep: Path, jobs: Sequence[Outcome]) -> str:
    """A line for each job that is not done: its folder, what it sets otherwise than others, why it
    is not; "" where all are done."""
    keys = differing_keys(jobs)
    rows = [("job", "settings", "status")]
    for job in jobs:
        if job.status != "done":
            own = [f"{key}={job.settings[key]}" for key in keys if key in job.settings]
            where = _below(sweep, job.folder) or "-"
            rows.append((where, " ".join(own) or "-", f"{job.status}: {job.why}"))
    widths = [max(len(row[column]) for row in rows) for column in range(2)]
    lines = [f"{a:{widths[0]}}  {b:{widths[1]}}  {c}" for a, b, c in rows]
    return "\n".join(lines) if len(lines) > 1 else ""
