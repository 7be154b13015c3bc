"""A run's folder: who made it, what became of it, and what it holds."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import shlex
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from edtorch.app.errors import ConfigError, no_such_folder
from edtorch.checkpoint import FileProblem, write_text

CONFIG = "config.yaml"
STATUS = "status.json"
POLICY = "policy.safetensors"
CHECKPOINT = "checkpoint.pt"
PACKAGES = ("edtorch", "torch", "numpy", "hydra-core", "gymnasium", "tensorboard", "matplotlib")


def versions() -> dict[str, str]:
    """Versions of what the digits depend on."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        found[name] = importlib.metadata.version(name)
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
    """JSON for a file, with NaN and infinities as null."""
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


class RunFolder:
    """The folder of one training run, from the moment its configuration is known to be good."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._began = time.time()

    def begin(self, config: DictConfig, seeds: list[int]) -> None:
        """Write what is known before the first tick.

        Raises ConfigError if the folder already holds a run or cannot be written to.
        """
        if (self.path / STATUS).exists():
            raise ConfigError(
                f"hydra.run.dir={self.path}: already holds a run; expected a new folder"
            )
        try:
            write_text(self.path / CONFIG, OmegaConf.to_yaml(config, resolve=True))
        except OSError as error:
            raise ConfigError(
                f"hydra.run.dir={self.path}: cannot be written to ({error.strerror})"
            ) from error
        about = {
            "command": command_line(),
            "seeds": seeds,
            "versions": versions(),
            "git": git_commit(),
            "host": socket.gethostname(),
            "cpu_threads": os.cpu_count(),
        }
        write_text(self.path / "run.json", json_text(about))
        self.set_status("running")

    def set_status(self, status: str, why: str | None = None) -> None:
        """``running``, ``done``, ``interrupted`` or ``failed``, with the reason."""
        content = {
            "status": status,
            "why": why,
            "pid": os.getpid(),
            "seconds": round(time.time() - self._began, 3),
        }
        write_text(self.path / STATUS, json_text(content))


def remove_if_empty(path: Path) -> None:
    """Remove the folder that Hydra made for a run that never began."""
    if path.is_dir() and not any(path.iterdir()):
        path.rmdir()


def load_config(folder: Path) -> DictConfig:
    """The resolved configuration of a run.  Raises NotARun or FileProblem."""
    path = folder / CONFIG
    if not path.is_file():
        raise no_such_folder(folder, CONFIG)
    try:
        config = OmegaConf.load(path)
    except (YAMLError, OmegaConfBaseException, UnicodeDecodeError) as error:
        raise FileProblem(f"{path}: not a configuration ({error})") from error
    if not isinstance(config, DictConfig) or "domain" not in config or "policy" not in config:
        raise FileProblem(f"{path}: not the configuration of a training run")
    return config
