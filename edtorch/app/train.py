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
from edtorch.app.folders import remove_empty
from edtorch.app.schema import checked
from edtorch.app.signals import Stop
from edtorch.app.trust import trusted

_STARTED = time.monotonic() - time.process_time()
"""When the process began, near enough: until now it has only imported."""


def _task(composed: Any) -> float:
    """One job.  Returns its headline figure, for sweepers to minimise."""
    hydra = HydraConfig.get()
    alone = hydra.mode == RunMode.RUN
    began = _STARTED if alone else time.monotonic()
    folder = Path(hydra.runtime.output_dir)
    stop = Stop()
    try:
        # Paths are relative to where the user stands, whatever hydra.job.chdir says.
        with stop.listening(), refusing(), contextlib.chdir(hydra.runtime.cwd):
            settings = checked(plainly(composed))
            # Not before: what a job needs takes seconds to import.
            from edtorch.app.rundir import RunFolder
            from edtorch.app.work import headline, run

            key = "hydra.run.dir" if alone else "hydra.sweep.dir"
            summary = run(settings, RunFolder(folder, key), stop, began)
    finally:
        if not alone:
            remove_empty(folder, folder.parent)
    return headline(summary)


def _train() -> None:
    given = settings_typed()
    if "resume" not in given:
        launch(_task, CONF, "train")
        return
    folder, trust = given.pop("resume"), given.pop("trust", ())
    if not isinstance(folder, str) or not folder:
        raise ConfigError(f"resume={folder}: expected the folder of a run")
    stop = Stop()
    with stop.listening():
        from edtorch.app.resume import resume

        resume(Path(folder), given, stop, _STARTED, trusted(trust))


def main() -> None:
    """Entry point of ``edtorch-train``."""
    sys.exit(guarded("edtorch-train", _train))


if __name__ == "__main__":
    main()
