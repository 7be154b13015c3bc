"""What a run leaves in its folder."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edtorch.app.job import Job, Work
from edtorch.app.rundir import POLICY, SUMMARY, RunFolder, json_text, settings_text
from edtorch.app.settings import Settings
from edtorch.app.summary import flat_settings, medians
from edtorch.run.checkpoint import save_policy, write_text
from edtorch.run.log import CsvSink, Entry, Sink, TensorBoardSink


def open_sinks(
    work: Work, config: Settings, folder: Path
) -> tuple[list[Sink], TensorBoardSink | None]:
    """What writes the progress of ``work`` to files of ``folder``, and TensorBoard's alone."""
    sinks: list[Sink] = [CsvSink(folder, work.columns, work.measures)]
    board = TensorBoardSink(folder, settings_text(config)) if config.log.tensorboard else None
    return (sinks if board is None else [*sinks, board]), board


def save_learned(work: Work, folder: Path, *, ended: bool) -> None:
    """Save what there is; the policies when learning has ended."""
    work.save(folder, ended=ended)
    if ended:
        save_policy(folder / POLICY, work.stored, work.card)


def save_results(job: Job, folder: Path, board: TensorBoardSink | None) -> dict[str, Any]:
    """After the evaluation: policies, figures and summary; returns the content of the latter."""
    work, log = job.work, job.config.log
    save_policy(folder / POLICY, work.stored, work.card)
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


class Replay:
    """Keeps the progress of a run, to write it later."""

    def __init__(self) -> None:
        self._kept: list[Entry] = []

    def write(self, entry: Entry) -> None:
        """See ``Sink``."""
        self._kept.append(entry)

    def close(self) -> None:
        """See ``Sink``."""

    def replay(self, sinks: Sequence[Sink]) -> None:
        """Write all of it to others."""
        for entry in self._kept:
            for sink in sinks:
                sink.write(entry)


def write_run(job: Job, memory: Replay, path: Path, *, interrupted: bool) -> None:
    """Write the complete folder of a run that is over, as ``edtorch-train`` leaves it."""
    path.mkdir(parents=True, exist_ok=True)
    folder = RunFolder(path, "folder")
    folder.begin(job.config, job.work.seeds)
    sinks, board = open_sinks(job.work, job.config, path)
    try:
        memory.replay(sinks)
        save_learned(job.work, path, ended=True)
        if not interrupted:
            save_results(job, path, board)
    finally:
        for sink in sinks:
            sink.close()
    if interrupted:
        folder.set_status("interrupted", "stopped by a signal; the state at that time is saved")
    else:
        folder.set_status("done")
