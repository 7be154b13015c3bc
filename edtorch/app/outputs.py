"""What a run leaves in its folder."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edtorch.app.checkpoints import CHECKPOINTS, save_checkpoint
from edtorch.app.job import Job, Work
from edtorch.app.rundir import (
    INTERRUPTED,
    POLICY,
    SUMMARY,
    RunFolder,
    json_text,
    settings_text,
)
from edtorch.app.settings import Settings
from edtorch.app.summary import flat_settings, medians
from edtorch.run.files import write_text
from edtorch.run.log import CsvSink, Entry, Sink, TensorBoardSink
from edtorch.run.policy_file import save_policy

logger = logging.getLogger("edtorch")


def open_sinks(
    work: Work, config: Settings, folder: Path
) -> tuple[list[Sink], TensorBoardSink | None]:
    """What writes the progress of ``work`` to files of ``folder``, and TensorBoard's alone."""
    sinks: list[Sink] = [CsvSink(folder, work.columns, work.measures)]
    board = TensorBoardSink(folder, settings_text(config)) if config.log.tensorboard else None
    return (sinks if board is None else [*sinks, board]), board


class Keeper:
    """Saves states of a job in a run's folder.

    A disk that is full or cannot be written to stops no learning: the last good checkpoint stays.
    """

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self._said: set[str] = set()

    def keep(self, job: Job) -> None:
        """Save the present state."""
        self.write(job, job.state())

    def write(self, job: Job, state: Mapping[str, Any]) -> None:
        """Save a state to which all that the sinks were given belongs, and the policies beside it;
        nothing where the method does not hold its state."""
        work, folder = job.work, self._folder.path
        if state["work"] is None:
            return
        try:
            files = [path for sink in job.sinks for path in sink.flush()]
            files += work.flush(folder)
            save_checkpoint(folder, work, state, files, job.config)
            _save_policies(work, folder)
        except OSError as error:
            why = error.strerror or str(error)
            if why not in self._said:
                self._said.add(why)
                logger.warning(
                    "%s: the state could not be saved (%s); learning goes on, and the last"
                    " checkpoint stays",
                    *(folder / CHECKPOINTS, why),
                )


def save_learned(work: Work, folder: Path) -> None:
    """Save what there is when learning is over."""
    work.save(folder)
    _save_policies(work, folder)


def _save_policies(work: Work, folder: Path) -> None:
    """As far as there are any."""
    if stored := work.stored:
        save_policy(folder / POLICY, stored, work.card)


def save_results(job: Job, folder: Path, board: TensorBoardSink | None) -> dict[str, Any]:
    """After the evaluation: policies, figures and summary; returns the content of the latter."""
    work, log = job.work, job.config.log
    _save_policies(work, folder)
    began = time.monotonic()
    figure = work.draw(folder, animate=log.animation) if log.figures else None
    if board is not None and figure is not None:
        board.writer.add_figure("learning_curve", figure, round(work.seconds))
    job.timing.figures_s = time.monotonic() - began
    summary = job.summary()
    if board is not None:
        board.hparams(flat_settings(job.config), medians(summary))
    write_text(folder / SUMMARY, json_text(summary))
    return summary


class InMemory:
    """Keeps the progress of a job and its last state, to write them later."""

    def __init__(self) -> None:
        self._entries: list[Entry] = []
        self._state: tuple[int, dict[str, Any]] | None = None

    def write(self, entry: Entry) -> None:
        """See ``Sink``."""
        self._entries.append(entry)

    def flush(self) -> Sequence[Path]:
        """See ``Sink``."""
        return ()

    def close(self) -> None:
        """See ``Sink``."""

    def keep(self, job: Job) -> None:
        """Keep the state of the job, and how many entries there were then."""
        self._state = len(self._entries), job.state()

    def replay(self, job: Job, keeper: Keeper) -> None:
        """Write all entries to the sinks of ``job``, and its state between them."""
        count, state = self._state or (0, None)
        self._write(job, self._entries[:count])
        if state is not None:
            keeper.write(job, state)
        self._write(job, self._entries[count:])

    @staticmethod
    def _write(job: Job, entries: Sequence[Entry]) -> None:
        for entry in entries:
            for sink in job.sinks:
                sink.write(entry)


def write_run(job: Job, memory: InMemory, path: Path, *, interrupted: bool) -> None:
    """Write the complete folder of a run that is over, as ``edtorch-train`` leaves it."""
    path.mkdir(parents=True, exist_ok=True)
    folder = RunFolder(path, "folder")
    folder.begin(job.config, job.work.seeds)
    folder.add("computed", job.work.computed)
    job.sinks, board = open_sinks(job.work, job.config, path)
    try:
        memory.replay(job, Keeper(folder))
        save_learned(job.work, path)
        if not interrupted:
            save_results(job, path, board)
    finally:
        for sink in job.sinks:
            sink.close()
    folder.end(*(INTERRUPTED if interrupted else ("done",)))
