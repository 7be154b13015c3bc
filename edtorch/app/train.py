"""``edtorch-train``: learn, evaluate, and leave a complete run folder; or go on in one."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

from edtorch.app.compose import CONF, launch, plainly, settings_typed
from edtorch.app.errors import ConfigError, guarded, refusing
from edtorch.app.schema import checked
from edtorch.app.signals import Stop
from edtorch.app.sweep import following
from edtorch.app.sweep_job import run_job
from edtorch.app.trust import trusted

_STARTED = time.monotonic() - time.process_time()
"""When the process began, near enough: until now it has only imported."""


def _task(composed: Any) -> float:
    """One job.  Returns its headline figure, for sweepers to minimise."""
    hydra = HydraConfig.get()
    if hydra.mode != RunMode.RUN:
        return run_job(composed, time.monotonic())
    stop = Stop()
    # Paths are relative to where the user stands, whatever hydra.job.chdir says.
    with stop.listening(), refusing(), contextlib.chdir(hydra.runtime.cwd):
        settings = checked(plainly(composed))
        if settings.sweep.name is not None:
            raise ConfigError(f"sweep.name={settings.sweep.name}: expected -m, for a sweep")
        # Not before: what a job needs takes seconds to import.
        from edtorch.app.rundir import RunFolder
        from edtorch.app.work import headline, run

        folder = RunFolder(Path(hydra.runtime.output_dir))
        return headline(run(settings, folder, stop, _STARTED))


def _command() -> None:
    given = settings_typed()
    if "resume" not in given:
        with following("edtorch-train"):
            launch(_task, CONF, "train")
        return
    folder, trust = given.pop("resume"), given.pop("trust", ())
    if not isinstance(folder, str) or not folder:
        shown = "null" if folder is None else folder
        raise ConfigError(f"resume={shown}: expected the folder of a run")
    stop = Stop()
    with stop.listening():
        from edtorch.app.resume import resume

        resume(Path(folder), given, stop, _STARTED, trusted(trust))


def main() -> None:
    """Entry point of ``edtorch-train``."""
    sys.exit(guarded("edtorch-train", _command))


if __name__ == "__main__":
    main()
