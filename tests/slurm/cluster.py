"""A SLURM cluster of this machine alone, for as long as a test needs it."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
NEEDED = ("munged", "slurmctld", "slurmd", "sbatch")


def why_not() -> str | None:
    """Why no SLURM can be started here; None: it can."""
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing:
        return (
            f"SLURM is not installed: no {', '.join(missing)} in the PATH;"
            " make test-slurm installs it as root, on Debian"
        )
    return None if os.geteuid() == 0 else "SLURM cannot be started: only root can run slurmd"


@dataclass(frozen=True)
class Cluster:
    """One that runs.  folder: of its files."""

    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        """For processes that use it."""
        path = f"{self.folder / 'bin'}:{os.environ['PATH']}"
        return os.environ | {"SLURM_CONF": str(self.folder / "slurm.conf"), "PATH": path}

    def ask(self, *command: str, folder: Path | None = None) -> str:
        """What a command of SLURM's answers, in a folder."""
        done = subprocess.run(
            command, cwd=folder, env=self.environment, capture_output=True, text=True
        )
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout

    def submit(self, *arguments: str, folder: Path) -> str:
        """The number of a job that ``sbatch`` with these arguments has made, in a folder."""
        return self.ask("sbatch", "--parsable", *arguments, folder=folder).strip()

    def facts(self, job: str) -> dict[str, str]:
        """What SLURM knows of a job; job: by its own number, not that of its array."""
        # One job of an array has the number of the whole, for which all are shown.
        shown = self.ask("scontrol", "--oneliner", "show", "job", job).splitlines()
        found = [dict(re.findall(r"(\S+?)=(\S*)", line)) for line in shown]
        return next(each for each in found if each["JobId"] == job)

    def task(self, job: str) -> str:
        """The name of a job as a part of its array."""
        facts = self.facts(job)
        return f"{facts['ArrayJobId']}_{facts['ArrayTaskId']}"

    def state(self, job: str) -> str:
        """``PENDING``, ``RUNNING``, ..."""
        return self.facts(job)["JobState"]


@contextmanager
def started(folder: Path, cpus: int) -> Iterator[Cluster]:
    """A cluster with so many cores, which need not exist."""
    done = subprocess.run(
        ["bash", str(HERE / "up.sh"), str(folder), str(cpus), str(_free_ports())],
        capture_output=True,
        text=True,
    )
    try:
        assert done.returncode == 0, done.stderr
        yield Cluster(folder)
    finally:
        subprocess.run(["bash", str(HERE / "down.sh"), str(folder)], check=True)


def _free_ports() -> int:
    """The first of two neighbours."""
    while True:
        with socket.socket() as one, socket.socket() as other:
            one.bind(("127.0.0.1", 0))
            port = one.getsockname()[1]
            try:
                other.bind(("127.0.0.1", port + 1))
            except (OSError, OverflowError):
                continue
            return port
