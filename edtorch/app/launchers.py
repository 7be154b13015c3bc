"""Hydra's launchers as sweeps need them: installed, with few threads, and followed to the end."""

from __future__ import annotations

import os
import shutil
import traceback
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from omegaconf import DictConfig, read_write

_SUBMITIT = ("hydra-submitit-launcher", "hydra_plugins.hydra_submitit_launcher", "submitit")
_PACKAGES = {
    "joblib": ("hydra-joblib-launcher", "hydra_plugins.hydra_joblib_launcher", "joblib"),
    "submitit": _SUBMITIT,
    "slurm": _SUBMITIT,
}
"""By the beginning of a launcher's name: the package that brings it, and modules that it needs."""
_BASIC = "hydra._internal.core_plugins.basic_launcher.BasicLauncher"
_ALL_CORES = -1
"""What joblib's launcher has by default for its jobs at a time."""
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Variables that limit the threads of a process; they count when it imports torch, not later."""


def not_installed(name: str) -> str | None:
    """The line for an option of ``hydra/launcher`` whose package is not there; None for others."""
    for beginning, (package, *modules) in _PACKAGES.items():
        if name.startswith(beginning) and not all(map(_is_there, modules)):
            return (
                f"hydra/launcher={name}: {package} is not installed;"
                ' pip install "edtorch[sweep]" brings it'
            )
    return None


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of hydra_plugins itself
        return False


def problem(name: str, target: str) -> str | None:
    """Why a launcher cannot be used on this machine, None where it can.

    name: its option of ``hydra/launcher``; target: its class.
    """
    if target.endswith(".SlurmLauncher") and shutil.which("srun") is None:
        no_slurm = "expected a machine with SLURM, but srun is not in the PATH"
        return not_installed(name) or f"hydra/launcher={name}: {no_slurm}"
    return not_installed(name)


def share_cores(launcher: DictConfig, threads: int) -> Mapping[str, str]:
    """Let a launcher run no more jobs at a time than there are cores for, with so many threads
    each.  Returns variables of the environment, for the processes that it starts."""
    if launcher.get("n_jobs") == _ALL_CORES:
        # No preset can say it: one called joblib would have the name of the launcher's own.
        with read_write(launcher):
            launcher.n_jobs = max(1, _cores() // max(1, threads))
    basic = launcher._target_ == _BASIC
    return {} if basic else dict.fromkeys(_THREADS, str(threads))


def _cores() -> int:
    """That this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def is_of_launcher(error: BaseException) -> bool:
    """Whether it was raised by what launchers are made of, and not by Hydra or by edtorch."""
    return type(error).__module__.partition(".")[0] in ("joblib", "submitit")


def left_behind(error: BaseException) -> list[Any]:
    """The jobs of submitit that its launcher waited for when ``error`` ended it.

    It ends with the first one that has no result, or with Ctrl-C, and the others go on.  Nobody
    else knows them: they are found where it has them.
    """
    for frame, _ in traceback.walk_tb(error.__traceback__):
        if frame.f_globals.get("__name__", "").startswith("hydra_plugins.hydra_submitit_launcher"):
            return list(frame.f_locals.get("jobs", ()))
    return []
