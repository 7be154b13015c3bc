"""``edtorch-train``: learn, evaluate, and leave a complete run folder."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from edtorch.app import schemas
from edtorch.app.build import Setup, build
from edtorch.app.errors import ConfigError, guarded, refusing
from edtorch.app.evaluations import Evaluations, News
from edtorch.app.folders import remove_empty
from edtorch.app.offline import build_offline, is_offline, run_offline
from edtorch.app.pictures import draw, draw_reaching
from edtorch.app.random_search import build_search, is_rival, is_search, run_search
from edtorch.app.rivals import build_rival, run_rival
from edtorch.app.rundir import (
    CHECKPOINT,
    POLICY,
    SUMMARY,
    TRANSITIONS,
    RunFolder,
    command_line,
    json_text,
    versions,
)
from edtorch.app.signals import Interrupted, Stop
from edtorch.app.summary import (
    Timing,
    broken,
    flat_settings,
    medians,
    summarise,
    summary_table,
)
from edtorch.compiled.compilation import CannotCompile
from edtorch.compiled.tiles import Tiles
from edtorch.errors import CovarianceFloored
from edtorch.learner.learner import Learner
from edtorch.run.checkpoint import save_policy, save_training, write_text
from edtorch.run.log import ConsoleSink, CsvSink, Sink, StderrHandler, TensorBoardSink
from edtorch.run.recorder import Recorder
from edtorch.run.training import Training
from edtorch.run.transitions_file import gathered, save_transitions

logger = logging.getLogger("edtorch")

_STARTED = time.monotonic() - time.process_time()
"""When the process began, near enough: until now it has only imported."""
_PIECE = 64
"""Ticks between two looks at whether to stop."""


class _Stopped(Exception):
    """Somebody asked, and the last tick is complete."""


@dataclass
class _Job:
    """One training run under way."""

    setup: Setup
    config: DictConfig
    folder: RunFolder
    stop: Stop
    console: Console
    began: float
    recorder: Recorder | None = None

    @property
    def path(self) -> Path:
        """The run folder."""
        return self.folder.path


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


def _report_evaluation(job: _Job, news: News, sinks: list[Sink]) -> None:
    """One line on the console, and scalars."""
    line = f"after {news.minutes:g} min: {news.text}"
    job.console.print(line, soft_wrap=True, highlight=False)
    for sink in sinks:
        if isinstance(sink, TensorBoardSink):
            sink.spreads("evaluation", news.figures, round(60 * news.minutes))


def _learn(job: _Job, training: Training, sinks: list[Sink], evaluations: Evaluations) -> None:
    """Run the loop to the end of every budget, reporting on the way."""
    log, after = job.config.log, job.setup.compute.after
    per_snapshot = max(1, round(log.every / training.world.dt))
    next_save = log.checkpoint
    reported, warned, floored = 0, set(), set()
    waiting = job.setup.compiled
    while not training.done:
        if waiting is not None and training.clock >= after:
            _go_on_compiled(training, waiting, required=job.setup.compute.required)
            waiting = None
        ticks = evaluations.ticks_ahead(training.clock, per_snapshot)
        if waiting is not None:
            ticks = min(ticks, after - training.clock)
        _advance(training, ticks, job.stop)
        snapshot = training.snapshot()
        if job.setup.indicator is not None:
            estimate = job.setup.indicator(training.learners, training.worlds.observation)
            snapshot = dataclasses.replace(snapshot, value_error=estimate.tolist())
        for sink in sinks:
            sink.write(snapshot, training.episodes[reported:])
        reported = len(training.episodes)
        _warn_of_trouble(training, warned)
        _warn_of_floors(training, floored)
        news = evaluations.run_if_due(training)
        if news is not None:
            _report_evaluation(job, news, sinks)
        if training.seconds >= next_save:
            save_training(job.path / CHECKPOINT, training)
            next_save += log.checkpoint


def _learn_and_save(
    job: _Job, training: Training, sinks: list[Sink], timing: Timing, evaluations: Evaluations
) -> None:
    """Learn; however that ends, time it and save what has been learned."""
    wall, cpu = time.monotonic(), time.process_time()
    try:
        with job.stop.between_ticks(), contextlib.suppress(_Stopped):
            _learn(job, training, sinks, evaluations)
    finally:
        with job.stop.not_now():
            timing.wall_s = time.monotonic() - wall - evaluations.wall_s
            timing.cpu_s = time.process_time() - cpu - evaluations.cpu_s
            timing.ticks = int(training.learners.tick.sum())
            save_training(job.path / CHECKPOINT, training)
            save_policy(job.path / POLICY, evaluations.to_save(training), job.setup.card)
            _save_transitions(job)
    if job.stop.asked:
        raise KeyboardInterrupt


def _save_transitions(job: _Job) -> None:
    if job.recorder is None:
        return
    seeds, world = job.setup.seeds, job.setup.world
    lives = [job.recorder.lived(row) for row in range(len(seeds))]
    about = {"command": command_line(), "versions": versions()}
    recorded = gathered(lives, seeds, world.dt)
    save_transitions(job.path / TRANSITIONS, recorded, world.spec, about)


@contextlib.contextmanager
def _timed(timing: Timing, name: str) -> Iterator[None]:
    began = time.monotonic()
    yield
    setattr(timing, name, time.monotonic() - began)


def _measures(training: Training) -> list[str]:
    """Names of what the sim measures at the end of an episode, where that tells of a goal."""
    if not training.world.spec.goal:
        return []
    world, zero = training.worlds.world[:1], torch.zeros(1, dtype=torch.float64)
    return list(training.world.sim.measures(world, world, zero))


def _sinks(job: _Job, measures: list[str]) -> tuple[list[Sink], TensorBoardSink | None]:
    log = job.config.log
    sinks: list[Sink] = [CsvSink(job.path, measures)]
    board = None
    if log.tensorboard:
        board = TensorBoardSink(job.path, OmegaConf.to_yaml(job.config, resolve=True))
        sinks.append(board)
    if log.progress:
        sinks.append(ConsoleSink(job.console))
    return sinks, board


def _train(job: _Job) -> dict[str, Any]:
    """Learn, evaluate, write everything; returns the content of ``summary.json``."""
    setup, config, console = job.setup, job.config, job.console
    stride = max(1, setup.world.limit_ticks // 10_000)
    if config.log.transitions:
        job.recorder = Recorder(setup.learner, setup.world, len(setup.seeds))
        logger.info("every transition is kept, and the tick is not compiled for it")
    training = Training(
        setup.learner,
        setup.world,
        setup.seeds,
        setup.budget,
        stride,
        setup.schedule,
        job.recorder,
    )
    title = f"{setup.world.spec.name}, {len(setup.seeds)} learners"
    precision = "float64" if setup.world.dtype == torch.float64 else "mixed precision"
    logger.info("%s; %s; %s", title, setup.path, precision)
    timing = Timing(startup_s=time.monotonic() - job.began)
    sinks, board = _sinks(job, _measures(training))
    evaluations = Evaluations(setup, config)
    try:
        _learn_and_save(job, training, sinks, timing, evaluations)
        if config.eval.episodes and not evaluations.is_fresh(training):
            console.print(f"{config.eval.episodes} fresh episodes for each policy...")
        evaluations.run(training)
        if evaluations.kept is not None:
            save_policy(job.path / POLICY, evaluations.kept.parameters, setup.card)
        timing.eval_s = evaluations.wall_s
        with _timed(timing, "figures_s"):
            if config.log.figures:
                animate = config.log.animation
                if setup.world.spec.goal:
                    figure = draw_reaching(training, setup.calm(), job.path, animate=animate)
                else:
                    figure = draw(training, job.path, animate=animate)
                if board is not None:
                    board.writer.add_figure("learning_curve", figure, round(training.seconds))
        summary = summarise(training, timing, evaluations)
        if board is not None:
            board.hparams(flat_settings(config), medians(summary))
    finally:
        for sink in sinks:
            sink.close()
    write_text(job.path / SUMMARY, json_text(summary))
    console.print(summary_table(summary, title))
    if summary["never_rode"]:
        console.print(_never_rode(summary["never_rode"]), soft_wrap=True)
    console.print(
        f"learning {timing.wall_s:.1f} s ({timing.ticks_per_cpu_s:.0f} learner ticks per CPU s),"
        f" evaluation {timing.eval_s:.1f} s, pictures {timing.figures_s:.1f} s",
        soft_wrap=True,
    )
    console.print(f"run folder: {job.path}", soft_wrap=True)
    return summary


def _never_rode(seeds: list[int], most: int = 20) -> str:
    listed = ", ".join(map(str, seeds[:most]))
    more = f" and {len(seeds) - most} more" if len(seeds) > most else ""
    return f"never rode: seeds {listed}{more}"


@contextlib.contextmanager
def _logging_to(folder: Path) -> Iterator[None]:
    """Messages go to ``run.log`` in the folder, and to stderr."""
    file = logging.FileHandler(folder / "run.log", encoding="utf-8")
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    stderr = StderrHandler()
    # What ends the run reaches the user as the command's last words.
    stderr.addFilter(lambda record: record.exc_info is None)
    handlers = [file, stderr]
    logger.setLevel(logging.INFO)
    logger.propagate = False
    for handler in handlers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for handler in handlers:
            logger.removeHandler(handler)
            handler.close()


def _work(
    config: DictConfig, folder: RunFolder, stop: Stop, began: float
) -> tuple[list[int], Callable[[], dict[str, Any]]]:
    """The seeds, and what there is to do: learn, or whatever a rival does instead."""
    if is_offline(config):
        offline = build_offline(config)
        seeds = offline.setup.seeds
        return seeds, lambda: run_offline(offline, config, folder.path, stop, Console(), began)
    if is_rival(config) and config.log.transitions:
        raise ConfigError("log.transitions=true: expected false with a rival, which keeps none")
    if is_rival(config) and not is_search(config):
        rival = build_rival(config)
        return rival.seeds, lambda: run_rival(rival, config, folder.path, stop, Console())
    if is_rival(config):
        search = build_search(config)
        return [search.seed], lambda: run_search(search, config, folder.path, stop, Console())
    setup = build(config)
    return setup.seeds, lambda: _train(_Job(setup, config, folder, stop, Console(), began))


def _headline(summary: dict[str, Any]) -> float:
    """What a sweeper minimises: simulated seconds before the first ride, or for a rival those that
    a policy costs that always reaches the goal."""
    if "seconds_before_first_ride" in summary:
        return float(summary["seconds_before_first_ride"]["median"])
    cost = summary["simulated_seconds_per_goal_policy"]
    return math.inf if cost is None else float(cost)


def _run(config: DictConfig, folder: RunFolder, stop: Stop, began: float) -> dict[str, Any]:
    """The job from configuration to table; the folder says at any time what has become of it."""
    seeds, work = _work(config, folder, stop, began)
    torch.set_num_threads(config.compute.threads)
    folder.begin(config, seeds)
    try:
        with _logging_to(folder.path):
            try:
                summary = work()
            except Exception:
                logger.exception("failed")
                raise
    except KeyboardInterrupt as error:
        with stop.not_now():
            folder.set_status("interrupted", "stopped by a signal; saved as of then")
        raise Interrupted(f"saved in {folder.path}") from error
    except BaseException as error:
        with stop.not_now(), contextlib.suppress(OSError):
            folder.set_status("failed", f"{type(error).__name__}: {error}")
        raise
    with stop.not_now():
        folder.set_status("done")
    if stop.asked:
        raise Interrupted(f"the run in {folder.path} is complete")
    return summary


def _task(config: DictConfig) -> float:
    """One job.  Returns its headline figure, for sweepers to minimise."""
    settings = HydraConfig.get()
    alone = settings.mode == RunMode.RUN
    began = _STARTED if alone else time.monotonic()
    key = "hydra.run.dir" if alone else "hydra.sweep.dir"
    folder = RunFolder(Path(settings.runtime.output_dir), key)
    stop = Stop()
    try:
        with stop.listening(), refusing(config.debug):
            summary = _run(config, folder, stop, began)
    finally:
        if not alone:
            remove_empty(folder.path, folder.path.parent)
    return _headline(summary)


def main() -> None:
    """Entry point of ``edtorch-train``."""
    schemas.register()
    run = hydra.main(version_base="1.3", config_path="pkg://conf", config_name="train")(_task)
    sys.exit(guarded("edtorch-train", run))


if __name__ == "__main__":
    main()
