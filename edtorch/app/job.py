"""A learner's job: learn to the end of every budget, then evaluate; the results stay in memory.

``edtorch-train`` writes them to a run folder, ``edtorch.learn`` hands them to its caller.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

import torch
from rich.console import Console

from edtorch.app.build import Setup
from edtorch.app.domain import described
from edtorch.app.errors import ConfigError
from edtorch.app.evaluations import Evaluations, News
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.summary import Timing, broken, summarise
from edtorch.compiled.compilation import CannotCompile
from edtorch.compiled.tiles import Tiles
from edtorch.errors import CovarianceFloored
from edtorch.learner.learner import Learner
from edtorch.report.domain import Domain
from edtorch.run.log import ConsoleSink, Sink, TensorBoardSink
from edtorch.run.recorder import Recorder
from edtorch.run.training import Training
from edtorch.types import Parameters

logger = logging.getLogger("edtorch")

_PIECE = 64
"""Ticks between two looks at whether to stop."""


class _Stopped(Exception):
    """A stop was requested, and the last tick is complete."""


class Job:
    """One training run: ``learn``, ``evaluate``, and then ``summary`` and ``policies``.

    setup: the objects; config: the configuration that they were built from; stop: looked at between
    ticks; console: gets the lines on the way; recorder: None unless ``log.transitions``.
    """

    def __init__(self, setup: Setup, config: Settings, stop: Stop, console: Console) -> None:
        self.setup = setup
        self.config = config
        self.stop = stop
        self.console = console
        self.timing = Timing()
        self.recorder: Recorder | None = None
        if config.log.transitions:
            self.recorder = Recorder(setup.world, len(setup.seeds))
            logger.info("every transition is kept, and the tick is not compiled for it")
        self.training = Training(
            setup.learner,
            setup.world,
            setup.seeds,
            setup.budget,
            max(1, setup.world.limit_ticks // 10_000),
            setup.schedule,
            self.recorder,
        )
        self.evaluations = Evaluations(setup, config, self._domain())
        for note in getattr(setup.world.sim, "notes", ()):
            logger.info("%s", note)
        budget = setup.budget.in_words(setup.world.spec.words.successes)
        logger.info("%s; at most %s each; %s; %s", self.title, budget, setup.path, self._precision)

    def _domain(self) -> Domain:
        world, zero = self.training.worlds.world[:1], torch.zeros(1, dtype=torch.float64)
        return described(self.setup.world, self.setup.world.sim.measures(world, world, zero))

    @property
    def title(self) -> str:
        """The domain, and how many learn in it."""
        return f"{self.setup.world.spec.name}, {len(self.setup.seeds)} learners"

    def console_sink(self) -> ConsoleSink:
        """The line on the way, with what the domain counts."""
        domain = self.evaluations.domain
        return ConsoleSink(
            self.console,
            words=domain.words,
            can_fail=domain.can_fail,
            can_succeed=domain.survival is not None,
        )

    @property
    def _precision(self) -> str:
        return "float64" if self.setup.world.dtype.itemsize == 8 else "mixed precision"

    @property
    def policies(self) -> Parameters:
        """The parameters ``[S, ...]`` that the run leaves: the best so far with ``eval.keep``."""
        return self.evaluations.to_save(self.training)

    def learn(self, sinks: Sequence[Sink], save: Callable[[Job, bool], None]) -> None:
        """Run the loop to the end of every budget, reporting to ``sinks`` on the way.

        save: called with this job, every ``log.checkpoint`` simulated seconds (False), and however
        learning ends (True).  Raises KeyboardInterrupt, after the tick, if a stop was requested.
        """
        wall, cpu = time.monotonic(), time.process_time()
        timing, evaluations = self.timing, self.evaluations
        try:
            with self.stop.between_ticks(), contextlib.suppress(_Stopped):
                self._loop(sinks, save)
        finally:
            with self.stop.not_now():
                timing.wall_s = time.monotonic() - wall - evaluations.wall_s
                timing.cpu_s = time.process_time() - cpu - evaluations.cpu_s
                timing.ticks = int(self.training.learners.tick.sum())
                save(self, True)
        if self.stop.asked:
            raise KeyboardInterrupt

    def evaluate(self) -> None:
        """Run the evaluation at the end, unless there has just been one."""
        if self.config.eval.episodes and not self.evaluations.is_fresh(self.training):
            count = self.config.eval.episodes
            self.console.print(f"{count} fresh episodes for each policy...")
        self.evaluations.run(self.training)
        self.timing.eval_s = self.evaluations.wall_s

    def summary(self) -> dict[str, Any]:
        """The content of ``summary.json``."""
        return summarise(self.training, self.timing, self.evaluations)

    def _loop(self, sinks: Sequence[Sink], save: Callable[[Job, bool], None]) -> None:
        training, setup = self.training, self.setup
        log, after = self.config.log, setup.compute.after
        per_snapshot = max(1, round(log.every / training.world.dt))
        next_save = log.checkpoint
        reported, warned, floored = 0, set[int](), set[int]()
        waiting = setup.compiled
        while not training.done:
            if waiting is not None and training.clock >= after:
                _go_on_compiled(training, waiting, required=setup.compute.required)
                waiting = None
            ticks = self.evaluations.ticks_ahead(training.clock, per_snapshot)
            if waiting is not None:
                ticks = min(ticks, after - training.clock)
            _advance(training, ticks, self.stop)
            snapshot = training.snapshot()
            if setup.indicator is not None:
                estimate = setup.indicator(training.learners, training.worlds.observation)
                snapshot = dataclasses.replace(snapshot, value_error=estimate.tolist())
            for sink in sinks:
                sink.write(snapshot, training.episodes[reported:])
            reported = len(training.episodes)
            _warn_of_trouble(training, warned)
            _warn_of_floors(training, floored)
            news = self.evaluations.run_if_due(training)
            if news is not None:
                self._report(news, sinks)
            if training.seconds >= next_save:
                save(self, False)
                next_save += log.checkpoint

    def _report(self, news: News, sinks: Sequence[Sink]) -> None:
        """One line on the console, and scalars."""
        line = f"after {news.minutes:g} min: {news.text}"
        self.console.print(line, soft_wrap=True, highlight=False)
        for sink in sinks:
            if isinstance(sink, TensorBoardSink):
                sink.spreads("evaluation", news.figures, round(60 * news.minutes))


def _warn_of_trouble(training: Training, warned: set[int]) -> None:
    """One line for each learner whose numbers broke, when it is first seen."""
    for row, (place, tick) in broken(training).items():
        if row not in warned:
            warned.add(row)
            logger.warning(
                "seed %d: not finite in %s from tick %d (%.2f s) on; such updates are skipped",
                training.seeds[row],
                place,
                tick,
                tick * training.world.dt,
            )


def _warn_of_floors(training: Training, warned: set[int]) -> None:
    """One line for each learner whose covariances had to be repaired, when it is first seen."""
    for row in (training.first_floored >= 0).nonzero().flatten().tolist():
        if row not in warned:
            warned.add(row)
            logger.warning(
                "seed %d: %s from step %d of the unroll on (tick %d or before): the covariance was "
                "not positive semidefinite",
                training.seeds[row],
                CovarianceFloored.__name__,
                int(training.first_floored[row]),
                training.clock,
            )


def _advance(training: Training, ticks: int, stop: Stop) -> None:
    """Run ``ticks`` ticks, or to the end of the tick in which a signal comes."""
    for done in range(0, ticks, _PIECE):
        training.advance(min(_PIECE, ticks - done))
        if stop.asked:
            raise _Stopped


def _go_on_compiled(training: Training, learner: Learner, *, required: bool) -> None:
    """From now on by a compiled program; without one, as before, if that is allowed."""
    began = time.monotonic()
    logger.info("compiling the tick, unless that has been done before...")
    try:
        tick = dataclasses.replace(training.tick, learner=learner)
        stage = Tiles(tick, training.stage.population, training.seeds)
    except CannotCompile as error:
        if required:
            raise ConfigError(f"compute.compile=on: {error}") from error
        logger.warning("not compiled, and several times slower for it: %s", error)
        return
    training.stage = stage
    how = "kept for the next run" if stage.was_compiled else "from the cache"
    logger.info(
        "compiled from tick %d on, in tiles of %d learners (%.1f s, %s)",
        training.clock,
        stage.size,
        time.monotonic() - began,
        how,
    )
