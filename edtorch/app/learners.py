"""Learners that live in their worlds."""

from __future__ import annotations

import dataclasses
import logging
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import torch
from matplotlib.figure import Figure
from rich.table import Table

from edtorch.app.build import Setup
from edtorch.app.compute import into_kernels
from edtorch.app.domain import described
from edtorch.app.evaluations import News
from edtorch.app.job import Job
from edtorch.app.learning import Learning
from edtorch.app.pictures import draw, draw_tasks
from edtorch.app.reward import near_seams
from edtorch.app.rundir import PART, TRANSITIONS, command_line, versions
from edtorch.app.settings import Settings
from edtorch.app.summary import (
    never_succeeded,
    summarise,
    summary_table,
)
from edtorch.run.episodes import episodes_of, episodes_state
from edtorch.run.log import EPISODES, Entry, read_episodes, spread_scalars
from edtorch.run.recorder import Recorder
from edtorch.run.training import Training
from edtorch.run.transitions_file import gathered, save_transitions

logger = logging.getLogger("edtorch")


class Learners(Learning):
    """Learners that live in their worlds."""

    def __init__(self, setup: Setup, config: Settings, folder: Path | None = None) -> None:
        """folder: the run's, where transitions go as they come; None: there is none yet."""
        self._setup = setup
        self._log_every: float = config.log.every
        self._recorder: Recorder | None = None
        self._noted = 0
        notes = [*self._fresh_notes(), *near_seams(config.reward, setup.world.spec)]
        if config.log.transitions:
            file = tempfile.TemporaryFile() if folder is None else _continued(folder / PART)
            self._recorder = Recorder(setup.world, len(setup.seeds), file)
            weakref.finalize(self._recorder, file.close)
        self._training = training = Training(
            setup.learner,
            setup.world,
            setup.seeds,
            setup.budget,
            max(1, setup.world.limit_ticks // 10_000),
            setup.schedule,
            self._recorder,
        )
        world, zero = training.worlds.world[:1], torch.zeros(1, dtype=torch.float64)
        domain = described(setup.world, setup.world.sim.measures(world, world, zero))
        title = f"{setup.world.spec.name}, {len(setup.seeds)} learners"
        super().__init__(setup, config, training, domain, title)
        budget = setup.budget.in_words(domain.words.successes)
        own = config.compute
        self._due, self._reported = self._next_report(), 0
        self.computed = into_kernels(training, own.native, own.threads, self._recorder)
        self.notes = [*notes, f"{title}; at most {budget} each; {setup.path}; {self.computed}"]
        self.measures = [m.name for m in domain.measures]

    def run(self, job: Job) -> None:
        """The loop to the end of every budget."""
        training = self._training
        while True:
            while training.clock < self._due and not training.done:
                training.advance(min(training.stage.piece, self._due - training.clock))
                job.whole()
            if training.done:
                # With a larger budget it could go on from here, before the report of the end.
                job.keep()
            self._report(job)
            if training.done:
                return
            self._due = self._next_report()

    def _next_report(self) -> int:
        """The tick of the next report."""
        every = max(1, round(self._log_every / self._training.world.dt))
        clock = self._training.clock
        return self._evaluations.next_after(clock, clock + every)

    def _report(self, job: Job) -> None:
        """Tell ``job`` what has happened since the last time; evaluate if it is time."""
        training, setup = self._training, self._setup
        snapshot = training.snapshot()
        if setup.indicator is not None:
            estimate = setup.indicator(training.learners, training.worlds.observation)
            snapshot = dataclasses.replace(snapshot, value_error=estimate.tolist())
        for note in self._fresh_notes():
            logger.info("%s", note)
        self._warn()
        episodes = training.episodes
        job.take(self._snapshots.entry(snapshot, episodes[self._reported :]))
        self._reported = len(episodes)
        with job.evaluation():
            news = self._evaluations.run_if_due(training)
        if news is not None:
            job.take(_entry(news))

    def state(self) -> dict[str, Any]:
        """See ``Work``; the episodes that were reported are in ``episodes.csv``."""
        return {
            **super().state(),
            "training": self._training.state(),
            "due": self._due,
            "reported": self._reported,
            "unreported": episodes_state(self._training.episodes[self._reported :]),
            "noted": self._noted,
        }

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``."""
        super().restore(state, folder)
        self._due, self._reported = state["due"], state["reported"]
        reported = read_episodes(folder / EPISODES, self.seeds)
        if len(reported) != self._reported:
            raise ValueError(f"{EPISODES}: has {len(reported)} episodes, expected {self._reported}")
        self._noted = state["noted"]
        self._training.restore(state["training"], [*reported, *episodes_of(state["unreported"])])

    def _fresh_notes(self) -> list[str]:
        """What the sim has to say that it had not said before."""
        notes: list[str] = [*getattr(self._setup.world.sim, "notes", ())]
        before, self._noted = self._noted, len(notes)
        return notes[before:]

    def flush(self, folder: Path) -> Sequence[Path]:
        """See ``Work``."""
        return [] if self._recorder is None else [self._recorder.flushed_to(folder / PART)]

    def save(self, folder: Path) -> None:
        """The transitions if they are kept."""
        if self._recorder is not None:
            world = self._setup.world
            lives = [self._recorder.lived(row) for row in range(len(self.seeds))]
            about = {"command": command_line(), "versions": versions()}
            recorded = gathered(lives, self.seeds, world.dt)
            save_transitions(folder / TRANSITIONS, recorded, world.spec, about)

    def draw(self, folder: Path, *, animate: bool) -> Figure:
        """Learning curve, and an animation if the sim can draw itself."""
        if self._training.world.spec.goal:
            return draw_tasks(self._training, self.domain, self.world(), folder, animate=animate)
        return draw(self._training, self.domain, folder, animate=animate)

    def summary(self) -> dict[str, Any]:
        """Without an evaluation in a run that was interrupted before it."""
        self._evaluations.leave_out(self._training)
        return summarise(self._training, self._evaluations)

    def told(self, summary: dict[str, Any]) -> list[Table | str]:
        """Figures over the seeds, who never succeeded, how long it took."""
        never = never_succeeded(summary, self.domain)
        return [
            summary_table(summary, self.domain, self.title),
            *([] if never is None else [never]),
            f"learning {summary['wall_s']:.1f} s ({summary['ticks_per_cpu_s']:.0f} learner ticks"
            f" per CPU s), evaluation {summary['eval_s']:.1f} s,"
            f" pictures {summary['figures_s']:.1f} s",
        ]


def _continued(path: Path) -> BinaryIO:
    """The file, to read and write, as it is if there is one."""
    return path.open("r+b" if path.exists() else "w+b")


def _entry(news: News) -> Entry:
    return Entry(
        scalars=spread_scalars("evaluation", news.figures),
        step=round(60 * news.minutes),
        news=f"after {news.minutes:g} min: {news.text}",
    )
