"""The checkpoints of a run: files with the whole state of its job, in a folder of their own."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from edtorch.app.errors import ConfigError
from edtorch.app.given import without_objects
from edtorch.app.job import Work
from edtorch.app.rundir import PART, versions
from edtorch.app.settings import Settings
from edtorch.app.summary import flat_settings
from edtorch.run.files import FileProblem, sync
from edtorch.run.log import EPISODES, EVENTS
from edtorch.run.state_file import load_state, save_state

logger = logging.getLogger("edtorch")

CHECKPOINTS = "checkpoints"
APPENDED = ("metrics.csv", EPISODES, EVENTS, PART)
"""What a run only ever appends to: a checkpoint has the sizes."""
CHANGEABLE = (
    "train.seconds",
    *(f"log.{name}" for name in ("checkpoint_wall", "checkpoints", "progress", "figures")),
    "log.animation",
    "debug",
)
"""Settings that may be others when a run goes on: what it computes does not depend on them."""


@dataclass(frozen=True)
class SavedJob:
    """state: of the job; seconds, computed: of ``Work``; files: sizes of what was appended to, by
    name; settings: flat; versions: as of ``run.json``; skipped: what is wrong with later ones."""

    path: Path
    state: Mapping[str, Any]
    seconds: float
    files: Mapping[str, int]
    settings: Mapping[str, Any]
    computed: str
    versions: Mapping[str, str]
    skipped: Sequence[FileProblem] = ()


def save_checkpoint(
    folder: Path,
    work: Work,
    state: Mapping[str, Any],
    appended: Sequence[Path],
    config: Settings,
) -> None:
    """Write one more, and delete all but the last ``log.checkpoints``.

    state: of a job with this work; appended: files of ``APPENDED`` that hold what the state belongs
    to.  Raises OSError; the others are then as they were.
    """
    for path in appended:
        sync(path)
    place = folder / CHECKPOINTS
    place.mkdir(exist_ok=True)
    before = _files(place)
    number = int(before[-1].stem) + 1 if before else 1
    content = {
        "state": dict(state),
        "seconds": work.seconds,
        "files": {path.name: path.stat().st_size for path in appended},
        "settings": flat_settings(Settings(without_objects(config))),
        "computed": work.computed,
        "versions": versions(),
    }
    save_state(place / f"{number:06d}.safetensors", content)
    for path in before[: max(0, len(before) + 1 - config.log.checkpoints)]:
        path.unlink(missing_ok=True)


def _files(place: Path) -> list[Path]:
    """The checkpoints in a folder, the last one last."""
    found = [path for path in place.glob("*.safetensors") if path.stem.isdigit()]
    return sorted(found, key=lambda path: int(path.stem))


def last_checkpoint(folder: Path) -> SavedJob | None:
    """The last whole checkpoint of a run whose files have what it needs; None: it has none at all.

    Raises FileProblem where there are some and none is whole.
    """
    problems: list[FileProblem] = []
    for path in reversed(_files(folder / CHECKPOINTS)):
        try:
            found = _load(path)
            _check_files(folder, found)
        except FileProblem as problem:
            problems.append(problem)
            continue
        return replace(found, skipped=problems)
    if problems:
        raise problems[0]
    return None


def _load(path: Path) -> SavedJob:
    content = load_state(path)
    try:
        return SavedJob(path, **content)
    except TypeError as error:
        raise FileProblem(f"{path}: expected the checkpoint of a run ({error})") from error


def _check_files(folder: Path, checkpoint: SavedJob) -> None:
    for name, size in checkpoint.files.items():
        path = folder / name
        found = path.stat().st_size if path.is_file() else 0
        if found < size:
            raise FileProblem(
                f"{path}: has {found} bytes, expected at least {size} for {checkpoint.path.name}:"
                " only half of the run was copied, or the file was changed"
            )


def check_same_run(checkpoint: SavedJob, config: Settings) -> None:
    """Refuse settings with which the run cannot go on from there; ConfigError."""
    most = config.train.seconds
    if most is not None and most < checkpoint.seconds * (1 - 1e-9):
        raise ConfigError(
            f"train.seconds={most:g}: expected at least the {checkpoint.seconds:g} s that the run"
            " has lived"
        )
    now = flat_settings(Settings(without_objects(config)))
    # What is not set is as it is by default, and is written down only where settings are complete.
    for key in checkpoint.settings.keys() & now.keys() - set(CHANGEABLE):
        before, after = checkpoint.settings[key], now[key]
        if before != after:
            raise ConfigError(
                f"{checkpoint.path}: made with {key}={before}, but the run has {key}={after};"
                " expected the checkpoint of the same run"
            )


def warn_of(checkpoint: SavedJob) -> None:
    """One line if it goes on with other packages than it was saved with, and one for each later
    checkpoint that is not whole."""
    for problem in checkpoint.skipped:
        logger.warning("%s; going on from %s, the one before", problem, checkpoint.path.name)
    now = versions()
    other = [
        f"{name} {before} is {now.get(name)} now"
        for name, before in checkpoint.versions.items()
        if now.get(name) != before
    ]
    if other:
        logger.warning("digits may differ from a run without a break: %s", "; ".join(other))


def cut(folder: Path, files: Mapping[str, int], patterns: Sequence[str] = APPENDED) -> None:
    """Shorten what was appended after a checkpoint with these sizes, and delete what was begun."""
    for pattern in patterns:
        for path in folder.glob(pattern):
            if path.name in files:
                os.truncate(path, files[path.name])
            else:
                path.unlink()
