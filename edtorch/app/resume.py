"""``edtorch-train resume=RUN``: a run goes on where it was when its process ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from edtorch.app.checkpoints import (
    CHANGEABLE,
    CHECKPOINTS,
    check_same_run,
    cut,
    last_checkpoint,
)
from edtorch.app.errors import ConfigError
from edtorch.app.learned import read_summary
from edtorch.app.rundir import (
    POLICY,
    SUMMARY,
    RunFolder,
    about_of,
    as_settings,
    holds_state,
    read_config,
    status_of,
)
from edtorch.app.schema import checked
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.trust import check_trust
from edtorch.app.work import carry_out, planned


def resume(
    folder: Path,
    changes: Mapping[str, Any],
    stop: Stop,
    began: float,
    trust: bool | Sequence[str] = (),
) -> dict[str, Any]:
    """Go on with the run in a folder, to the end; returns the content of its ``summary.json``.

    changes: settings by full key, of ``CHANGEABLE``; trust: packages whose code its configuration
    may import.  A run that is complete and not changed stays as it is.  Raises ConfigError, NotARun
    and FileProblem, before anything is written.
    """
    content = Settings(read_config(folder))
    check_trust(content, trust)
    return resume_with(folder, changed(folder, content, changes), stop, began, Console())


def changed(folder: Path, content: Settings, changes: Mapping[str, Any]) -> Settings:
    """The configuration of a run with these changes.  Raises ConfigError and FileProblem."""
    content = as_settings(folder, content)
    for key, value in changes.items():
        if key not in CHANGEABLE:
            raise ConfigError(
                f"{key}={value}: cannot be another in a run that goes on; expected one of"
                f" {', '.join(CHANGEABLE)}"
            )
        group, _, name = key.rpartition(".")
        content = content.merged({group: {name: value}} if group else {name: value})
    return checked(content)


def resume_with(
    folder: Path, config: Settings, stop: Stop, began: float, console: Console
) -> dict[str, Any]:
    """``resume`` with a complete configuration, which may hold objects."""

    def say(line: str) -> None:
        console.print(line, soft_wrap=True, highlight=False)

    run_folder = RunFolder(folder, "run")
    _, begin = planned(config)
    with run_folder.lock.held():
        about_of(folder)
        if status_of(folder) == "done" and not _is_larger(folder, config):
            say(f"the run in {folder} is complete: nothing is left to do")
            return read_summary(folder / SUMMARY)
        checkpoint = last_checkpoint(folder)
        if checkpoint is None:
            _clear(folder)
            say(f"the run in {folder} has no checkpoint: it begins at tick 0")
        else:
            check_same_run(checkpoint, config)
            say(f"going on from {checkpoint.path}")
        return carry_out(begin, config, run_folder, stop, began, console, checkpoint)


def _is_larger(folder: Path, config: Settings) -> bool:
    """Whether the budget is another than that of the run that has ended."""
    before = as_settings(folder, read_config(folder)).train.seconds
    return config.train.seconds != before


def _has_rows(path: Path) -> bool:
    """Whether a CSV file has more than its header."""
    return path.is_file() and len(path.read_bytes().splitlines()) > 1


def _clear(folder: Path) -> None:
    """Of a run without a checkpoint nothing is continued.  Raises ConfigError for one of an earlier
    version, in which there is more than can be continued."""
    if (folder / "checkpoint.pt").exists():
        raise ConfigError(
            f"run={folder}: was made by an earlier version, whose checkpoint.pt does not hold the"
            " whole state; expected a run with a folder checkpoints"
        )
    if holds_state(folder) and _has_rows(folder / "metrics.csv"):
        raise ConfigError(
            f"run={folder}: has no checkpoint in {folder / CHECKPOINTS}, though it had begun to"
            " learn: only half of the run was copied, or none could be saved; expected the whole"
            " folder, or a new run"
        )
    cut(folder, {})
    (folder / POLICY).unlink(missing_ok=True)
