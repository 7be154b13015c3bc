"""One process at a time in a run's folder."""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock

from edtorch.app.errors import ConfigError
from edtorch.run.files import write_text

LOCK = "run.lock"
BEAT = 15.0
"""Seconds between the signs of life that a process gives."""
STALE = 120.0
"""Seconds without one after which a process on another machine counts as dead.  A network file
system may show a time that is a minute old."""


class InUse(ConfigError):
    """Another process is at work in the folder."""


class Lock:
    """The lock of a run's folder: a file that names host and process.

    A process that is dead has no lock: one of this machine by its number and its start, one of
    another machine if it was an earlier start of the same SLURM job, or has given no sign of life
    for ``STALE`` seconds: the file is touched as long as the process lives, whatever it does.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        self._holder = {
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started": _started(os.getpid()),
            "slurm_job": os.environ.get("SLURM_JOB_ID"),
        }

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock in this block.  Raises InUse if another process holds it, and OSError where
        the folder cannot be written to."""
        with FileLock(_guard(self._path)):
            if (other := self.other()) is not None:
                raise InUse(
                    f"run={self._path.parent}: in use by {other}; if that has ended, delete"
                    f" {self._path}"
                )
            write_text(self._path, json.dumps(self._holder) + "\n")
        over = threading.Event()
        threading.Thread(target=self._live, args=(over,), daemon=True).start()
        try:
            yield
        finally:
            over.set()
            with contextlib.suppress(OSError):
                self._path.unlink(missing_ok=True)

    def other(self) -> str | None:
        """Which other process holds it, in words; None: no live one."""
        holder = _read(self._path)
        if holder is None or not self._is_alive(holder):
            return None
        return f"process {holder.get('pid')} on {holder.get('host')}"

    def _live(self, over: threading.Event) -> None:
        while not over.wait(BEAT):
            with contextlib.suppress(OSError):
                os.utime(self._path)

    def _is_alive(self, holder: dict[str, Any]) -> bool:
        if holder == self._holder:
            return False  # a file that was copied, or an earlier call in this process
        if holder.get("host") == self._holder["host"]:
            pid = holder.get("pid")
            return (
                isinstance(pid, int)
                and pid > 0
                and _runs(pid)
                and _started(pid) == holder.get("started")
            )
        job = holder.get("slurm_job")
        if job is not None and job == self._holder["slurm_job"]:
            return False
        return time.time() - self._path.stat().st_mtime < STALE


def _guard(path: Path) -> Path:
    """A file outside the folder, which two processes that look at the lock at once wait for."""
    name = hashlib.blake2b(str(path.absolute()).encode(), digest_size=8).hexdigest()
    return Path(tempfile.gettempdir()) / f"edtorch-{getpass.getuser()}-{name}.lock"


def _read(path: Path) -> dict[str, Any] | None:
    """Who holds it; None: nobody, or it cannot be told."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _started(pid: int) -> str | None:
    """When the process began, in ticks of its machine since the boot; None where /proc is not."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return None
    # The name, in parentheses, may hold anything.  Field 22 of proc(5).
    fields = text.rpartition(")")[2].split()
    return None if fields[0] == "Z" else fields[19]
