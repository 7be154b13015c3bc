"""A linear world that may not last: for jobs of sweeps, also in processes of their own."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import torch

from sims.linear import LinearSystem

MENDED = "mended"
"""A file in the working directory; where it is, what it names, or where it is empty nothing, goes
wrong any more."""
THREADS = "threads"
"""A file that says how many threads the process of a job was given."""


class Doomed(LinearSystem):
    """how begins with refuse: its arguments are refused; defect: it raises when it has been stepped
    a hundred times; kill: its process ends at that moment; wait: it waits there for a signal;
    anything else: nothing goes wrong."""

    def __init__(self, *, how: str = "fine", **more: Any) -> None:
        super().__init__(**more)
        mended = Path(MENDED).exists() and how.startswith(Path(MENDED).read_text())
        self._how = "fine" if mended else how.rstrip("0123456789")
        self._steps = 0
        if self._how == "refuse":
            raise ValueError(f"how={how}: expected another fate")
        Path(THREADS).write_text(os.environ.get("OMP_NUM_THREADS", "not limited"))

    def step(
        self, state: torch.Tensor, action: torch.Tensor, uniforms: torch.Tensor
    ) -> torch.Tensor:
        """See ``LinearSystem``."""
        self._steps += 1
        if self._steps == 100:
            if self._how == "defect":
                raise RuntimeError("the wheel\nfell off")
            if self._how == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self._how == "wait":
                Path("waiting").touch()
                signal.pause()
        return super().step(state, action, uniforms)
