"""What a learner's run leaves in its folder."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from edtorch.app.job import Job
from edtorch.app.pictures import draw, draw_tasks
from edtorch.app.rundir import (
    CHECKPOINT,
    POLICY,
    SUMMARY,
    TRANSITIONS,
    RunFolder,
    command_line,
    json_text,
    settings_text,
    versions,
)
from edtorch.app.summary import Timing, flat_settings, medians
from edtorch.report.statistics import evaluation_figures
from edtorch.run.checkpoint import save_policy, save_training, write_text
from edtorch.run.episodes import Episode, Snapshot
from edtorch.run.log import CsvSink, Sink, TensorBoardSink
from edtorch.run.transitions_file import gathered, save_transitions


@contextlib.contextmanager
def _timed(timing: Timing, name: str) -> Iterator[None]:
    began = time.monotonic()
    yield
    setattr(timing, name, time.monotonic() - began)


def open_sinks(job: Job, folder: Path) -> tuple[list[Sink], TensorBoardSink | None]:
    """What writes the progress of ``job`` to files of ``folder``, and TensorBoard's alone."""
    domain = job.evaluations.domain
    sinks: list[Sink] = [CsvSink(folder, [m.name for m in domain.measures], domain.words)]
    board = None
    if job.config.log.tensorboard:
        board = TensorBoardSink(folder, settings_text(job.config), domain.words)
        sinks.append(board)
    return sinks, board


def save_learned(job: Job, folder: Path, *, ended: bool) -> None:
    """Save the population; when learning has ended, also policies and recorded transitions."""
    save_training(folder / CHECKPOINT, job.training)
    if not ended:
        return
    save_policy(folder / POLICY, job.policies, job.setup.card)
    if job.recorder is not None:
        seeds, world = job.setup.seeds, job.setup.world
        lives = [job.recorder.lived(row) for row in range(len(seeds))]
        about = {"command": command_line(), "versions": versions()}
        recorded = gathered(lives, seeds, world.dt)
        save_transitions(folder / TRANSITIONS, recorded, world.spec, about)


def save_results(job: Job, folder: Path, board: TensorBoardSink | None) -> dict[str, Any]:
    """After the evaluation: policies, figures and summary; returns the content of the latter."""
    save_policy(folder / POLICY, job.policies, job.setup.card)
    training, log, domain = job.training, job.config.log, job.evaluations.domain
    with _timed(job.timing, "figures_s"):
        if log.figures:
            if training.world.spec.goal:
                calm = job.setup.calm()
                figure = draw_tasks(training, domain, calm, folder, animate=log.animation)
            else:
                figure = draw(training, domain, folder, animate=log.animation)
            if board is not None:
                board.writer.add_figure("learning_curve", figure, round(training.seconds))
    summary = job.summary()
    if board is not None:
        last = evaluation_figures(job.evaluations.done[-1].episodes, domain.measures, domain.words)
        board.spreads("evaluation", last, round(training.seconds))
        board.hparams(flat_settings(job.config), medians(summary))
    write_text(folder / SUMMARY, json_text(summary))
    return summary


class Memory:
    """Keeps the progress of a run, to write it later."""

    def __init__(self) -> None:
        self._kept: list[tuple[Snapshot, list[Episode]]] = []

    def write(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> None:
        """See ``Sink``."""
        self._kept.append((snapshot, list(episodes)))

    def close(self) -> None:
        """See ``Sink``."""

    def replay(self, sinks: Sequence[Sink]) -> None:
        """Write all of it to others."""
        for snapshot, episodes in self._kept:
            for sink in sinks:
                sink.write(snapshot, episodes)


def write_run(job: Job, memory: Memory, path: Path, *, interrupted: bool) -> None:
    """Write the complete folder of a run that is over, as ``edtorch-train`` leaves it."""
    path.mkdir(parents=True, exist_ok=True)
    folder = RunFolder(path, "folder")
    folder.begin(job.config, job.setup.seeds)
    sinks, board = open_sinks(job, path)
    try:
        memory.replay(sinks)
        save_learned(job, path, ended=True)
        if not interrupted:
            save_results(job, path, board)
    finally:
        for sink in sinks:
            sink.close()
    if interrupted:
        folder.set_status("interrupted", "stopped by a signal; the state at that time is saved")
    else:
        folder.set_status("done")
