"""``sweep.json``: which sweep a folder is of."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from edtorch.app.compose import prepared
from edtorch.app.errors import ConfigError
from edtorch.app.folders import remove_empty
from edtorch.app.options import WRITTEN_OUT
from edtorch.app.overrides import typed
from edtorch.app.rundir import CONFIG, STATUS, command_line, json_text, versions
from edtorch.app.sweep_names import key_of, significant
from edtorch.run.files import FileProblem, write_text

RECORD = "sweep.json"
JOB = "job.json"
"""In the folder of each job: its overrides."""
SUBMITTED = ".submitit"
"""What submitit's launcher keeps of the jobs that it has sent away, which may yet begin."""
_FORMAT = 1


@dataclass(frozen=True)
class Record:
    """overrides: those that can change results, as they were typed, sorted."""

    overrides: tuple[str, ...]

    @staticmethod
    def of_command() -> Record:
        """That of the command that is running."""
        return Record(tuple(o for o in sorted(typed()) if significant([o])))

    @staticmethod
    def read(folder: Path) -> Record:
        """Raises FileProblem."""
        path = folder / RECORD
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            version, overrides = content["format"], content["overrides"]
            known = version == _FORMAT and all(isinstance(each, str) for each in overrides)
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise FileProblem(f"{path}: expected the record of a sweep ({error})") from error
        if not known:
            raise FileProblem(
                f"{path}: expected the record of a sweep in format {_FORMAT}, not {version}"
            )
        return Record(tuple(overrides))

    def write(self, folder: Path) -> None:
        """Make the folder that of this sweep."""
        content = {
            "format": _FORMAT,
            "overrides": list(self.overrides),
            "command": command_line(),
            "versions": versions(),
        }
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / RECORD, json_text(content))

    def difference(self, other: Record) -> str | None:
        """What this sweep sets otherwise than ``other``, in words; None where they are the same."""
        here, there = (set(significant(prepared(record.overrides))) for record in (self, other))
        if here == there:
            return None
        return f"{_listed(here - there)} here, {_listed(there - here)} there"

    def as_typed(self, job: Sequence[str]) -> list[str]:
        """The overrides of a job of this sweep as the user would have typed them: as Hydra has
        them, options that were written out and former names of settings are gone."""
        present = zip(map(key_of, prepared(self.overrides)), self.overrides, strict=True)
        known = dict(present)
        found: list[str] = []
        for override in job:
            key, equals, value = override.partition("=")
            before = known.get(key_of(override), "")
            if before and value == WRITTEN_OUT:
                found.append(before)
            else:
                found.append(f"{before.partition('=')[0] or key}{equals}{value}")
        return found


def check_folder(name: str, folder: Path, record: Record) -> bool:
    """Whether ``folder`` holds the sweep ``record`` already.

    ConfigError where it holds anything else, or another sweep: but for one in which every job was
    refused, whose settings had to be changed.
    """
    given = f"sweep.name={name}"
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{given}: expected a folder, but {folder} is a file")
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    if not names:
        return False
    if RECORD not in names:
        raise ConfigError(
            f"{given}: expected a new folder or one of a sweep, but {folder} holds {names[0]} and"
            f" no {RECORD}"
        )
    different = record.difference(Record.read(folder))
    if different and _forgotten(folder):
        return False
    if different:
        raise ConfigError(
            f"{given}: {folder} holds a sweep with other settings ({different}); expected the same,"
            " or another name"
        )
    return True


def _forgotten(folder: Path) -> bool:
    """Remove the jobs of a sweep in which none has come to a run; whether it was such a one."""
    if (folder / SUBMITTED).exists() or any(folder.rglob(CONFIG)):
        return False
    for path in list(folder.rglob(JOB)):
        for each in (path, path.with_name(STATUS)):
            each.unlink(missing_ok=True)
        remove_empty(path.parent, folder)
    return True


def _listed(overrides: set[str], most: int = 5) -> str:
    shown = " ".join(sorted(overrides)[:most]) or "nothing"
    return f"{shown} and {len(overrides) - most} more" if len(overrides) > most else shown
