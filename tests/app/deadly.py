"""Steps of Cardea that kill their process: a module that a new process can import."""

from __future__ import annotations

import os
import signal

from sims.cardea.physics import StepArguments, step_rows


def step_rows_or_die(yaw: float, rows: list[StepArguments]) -> list[list[float]]:
    """``step_rows``, but a row whose first angle is ``yaw`` ends the process at once."""
    if any(state[0] == yaw for _, _, state, _ in rows):
        os.kill(os.getpid(), signal.SIGKILL)
    return step_rows(rows)
