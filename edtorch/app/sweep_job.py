"""One job of a sweep: passed over, gone on with or begun.  What goes wrong in it is recorded in its
folder and raised no further, so that the other jobs go on."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from rich.console import Console

from edtorch.app.compose import plainly
from edtorch.app.errors import EXPECTED, ConfigError, debugging, one_line
from edtorch.app.groups import SweepGroup
from edtorch.app.lock import InUse
from edtorch.app.overrides import typing
from edtorch.app.rundir import CONFIG, STATUS, SUMMARY, RunFolder, json_text, status_of
from edtorch.app.schema import checked
from edtorch.app.signals import Stop
from edtorch.app.sweep_names import significant
from edtorch.app.sweep_record import JOB, Record
from edtorch.run.files import write_text

FAILED = math.inf
"""The headline figure of a failed job: the worst one, for sweepers that minimise."""


class NotItsFolder(ConfigError):
    """The folder is that of something else, whose files are left alone."""


def run_job(composed: Any, began: float) -> float:
    """The job that Hydra composed, in the folder that Hydra made.  Returns its headline figure, or
    ``FAILED``.

    began: when, by the monotonic clock.
    """
    hydra = HydraConfig.get()
    folder, overrides = Path(hydra.runtime.output_dir), list(hydra.overrides.task)
    # Paths are relative to where the user stands, whatever hydra.job.chdir says.
    with contextlib.chdir(hydra.runtime.cwd):
        record = Record.read(Path(hydra.sweep.dir))
        with typing(record.as_typed(overrides)):
            try:
                return _run(composed, folder, significant(overrides), began)
            except Exception as error:
                _tell(folder, error)
                return FAILED


def _run(composed: Any, folder: Path, overrides: list[str], began: float) -> float:
    from edtorch.app.resume import resume_with
    from edtorch.app.work import headline, run

    stop = Stop()
    with stop.listening():
        _claim(folder, overrides)
        before = status_of(folder)
        if before == "done":
            print(f"done before: {folder}")
            return headline(json.loads((folder / SUMMARY).read_text(encoding="utf-8")))
        settings = checked(plainly(composed))
        if before == "failed" and not settings.sweep.retry:
            print(f"failed before: {folder}")
            return FAILED
        # The run itself is as it would be alone.
        settings = settings.merged({"sweep": asdict(SweepGroup())})
        if (folder / CONFIG).exists():
            summary = resume_with(folder, settings, stop, began, Console())
        else:
            (folder / STATUS).unlink(missing_ok=True)
            summary = run(settings, RunFolder(folder, "hydra.sweep.dir"), stop, began)
    return headline(summary)


def _claim(folder: Path, overrides: Sequence[str]) -> None:
    """Write down which job the folder is of.  Raises NotItsFolder."""
    path = folder / JOB
    if path.exists():
        if overrides_of(folder) == list(overrides):
            return
        raise NotItsFolder(f"{path}: expected the overrides {' '.join(overrides)}")
    if (folder / CONFIG).exists() or (folder / STATUS).exists():
        raise NotItsFolder(f"hydra.sweep.dir={folder.parent}: {folder.name} already holds a run")
    write_text(path, json_text({"overrides": list(overrides)}))


def overrides_of(folder: Path) -> list[str]:
    """Of the job in this folder."""
    return json.loads((folder / JOB).read_text(encoding="utf-8"))["overrides"]


def _tell(folder: Path, error: Exception) -> None:
    expected = isinstance(error, EXPECTED)
    if debugging() or not expected:
        traceback.print_exception(error)
    why = one_line(error)
    why = why if expected else f"{type(error).__name__}: {why}"
    print(f"edtorch-train: {folder}: {why}", file=sys.stderr)
    if isinstance(error, NotItsFolder | InUse) or status_of(folder) == "failed":
        return
    with contextlib.suppress(OSError):
        write_text(folder / STATUS, json_text({"status": "failed", "why": why}))
