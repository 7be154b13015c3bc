"""A run's folder: who made it, what became of it, and what it holds."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import platform
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edtorch.app.compose import as_yaml, read_yaml
from edtorch.app.errors import ConfigError, no_such_folder
from edtorch.app.given import without_objects
from edtorch.app.lock import Lock
from edtorch.app.schema import checked
from edtorch.app.settings import Settings
from edtorch.run.files import FileProblem, write_text

CONFIG = "config.yaml"
STATUS = "status.json"
POLICY = "policy.safetensors"
ABOUT = "run.json"
SUMMARY = "summary.json"
TRANSITIONS = "transitions.npz"
PART = "transitions.part"
"""The transitions of a run that keeps them, tick by tick."""
INTERRUPTED = ("interrupted", "stopped by a signal; edtorch-train resume=FOLDER goes on")
"""Status of a run that was stopped from outside, and why."""
PACKAGES = ("edtorch", "torch", "numpy", "hydra-core", "gymnasium", "tensorboard", "matplotlib")


def versions() -> dict[str, str]:
    """Versions of what the digits depend on."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        found[name] = importlib.metadata.version(name)
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        found["numba"] = importlib.metadata.version("numba")
    return found


def command_line() -> str:
    """The command as it was typed."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def git_commit() -> str | None:
    """Commit of the checkout that edtorch is installed from; None outside one."""
    here = Path(__file__).resolve().parent
    try:
        answer = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=here,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()


def json_text(content: Any) -> str:
    """JSON for a file.  Raises ValueError for NaN and infinities, which JSON does not know."""
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def settings_text(config: Settings) -> str:
    """The text of ``config.yaml``."""
    return as_yaml(without_objects(config))


class RunFolder:
    """The folder of one training run, from the moment its configuration is known to be good.

    key: the setting that names it; lock: see ``edtorch.app.lock``; is_running: between ``begin`` or
    ``go_on``, and ``end``.
    """

    def __init__(self, path: Path, key: str = "hydra.run.dir") -> None:
        self.path = path
        self.lock = Lock(path)
        self.is_running = False
        self._key = key
        self._began = time.time()

    def begin(self, config: Settings, seeds: list[int]) -> None:
        """Write what is known before the first tick.

        Raises ConfigError if the folder already holds a run or cannot be written to.
        """
        if (self.path / STATUS).exists() or (self.path / CONFIG).exists():
            raise ConfigError(
                f"{self._key}={self.path}: already holds a run; expected a new folder"
            )
        about = {
            "command": command_line(),
            "seeds": seeds,
            "versions": versions(),
            "git": git_commit(),
            "host": socket.gethostname(),
            "cpu_threads": os.cpu_count(),
        }
        files = (self.path / ABOUT, self.path / CONFIG)
        try:
            # The configuration makes it a run, which goes on with what is there.
            write_text(self.path / ABOUT, json_text(about))
            write_text(self.path / CONFIG, settings_text(config))
            self._run()
        except OSError as error:
            with contextlib.suppress(OSError):
                for path in files:
                    path.unlink(missing_ok=True)
            raise ConfigError(
                f"{self._key}={self.path}: expected a folder to write to ({error.strerror})"
            ) from error

    def go_on(self, config: Settings, tick: int) -> None:
        """Write that the run goes on, after ``tick`` learner ticks, with these settings."""
        about = about_of(self.path)
        again = {
            "command": command_line(),
            "host": socket.gethostname(),
            "ticks": tick,
            "time": time.strftime("%Y-%m-%d %H:%M:%S"),
            "versions": versions(),
        }
        resumed = [*about.get("resumed", []), again]
        # The summary of the earlier end is out of date once the run goes on.
        (self.path / SUMMARY).unlink(missing_ok=True)
        write_text(self.path / CONFIG, settings_text(config))
        write_text(self.path / ABOUT, json_text({**about, "resumed": resumed}))
        self._run()

    def add(self, fact: str, value: str | bool) -> None:
        """One more line in ``run.json``."""
        about = about_of(self.path)
        write_text(self.path / ABOUT, json_text({**about, fact: value}))

    def _run(self) -> None:
        self._set_status("running")
        self.is_running = True

    def end(self, status: str, why: str | None = None) -> None:
        """Write how it ended: ``done``, ``interrupted`` or ``failed``, with the reason; nothing
        where the run was refused before it went on."""
        if self.is_running:
            self._set_status(status, why)
            self.is_running = False

    def _set_status(self, status: str, why: str | None = None) -> None:
        content = {
            "status": status,
            "why": why,
            "pid": os.getpid(),
            "seconds": round(time.time() - self._began, 3),
        }
        write_text(self.path / STATUS, json_text(content))


def status_of(folder: Path) -> str | None:
    """What became of the run in a folder, as ``RunFolder.set_status`` says; None: unknown."""
    try:
        return json.loads((folder / STATUS).read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, LookupError, TypeError):
        return None


def about_of(folder: Path) -> dict[str, Any]:
    """The content of ``run.json``.  Raises FileProblem."""
    path = folder / ABOUT
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileProblem(f"{path}: expected the record of a run ({error})") from error
    if not isinstance(content, dict):
        raise FileProblem(f"{path}: expected the record of a run, a mapping")
    return content


def holds_state(folder: Path) -> bool:
    """Whether the method of a run saves its state; FileProblem where ``run.json`` is none."""
    return about_of(folder).get("holds_state", True) is not False


def load_config(folder: Path) -> Settings:
    """The resolved configuration of a run.  Raises NotARun or FileProblem."""
    return as_settings(folder, read_config(folder))


def read_config(folder: Path) -> Mapping[str, Any]:
    """The configuration of a run as its file has it.  Raises NotARun or FileProblem."""
    path = folder / CONFIG
    if not path.is_file():
        raise no_such_folder(folder, CONFIG)
    try:
        content = read_yaml(path)
    except ValueError as error:
        raise _unfit(path, error) from error
    if "domain" not in content or "policy" not in content:
        raise _unfit(path, "no domain or no policy")
    return content


def as_settings(folder: Path, content: Mapping[str, Any]) -> Settings:
    """What the configuration of the run in ``folder`` sets.  Imports the classes that it names.

    Raises FileProblem.
    """
    try:
        return checked(content)
    except ConfigError as error:
        raise _unfit(folder / CONFIG, error) from error


def _unfit(path: Path, why: object) -> FileProblem:
    return FileProblem(f"{path}: expected the configuration of a training run ({why})")
