"""What ``edtorch-train`` does once a configuration is accepted: the job, and its run folder."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from edtorch.app.build import build
from edtorch.app.build_planned import build_planned, is_planned
from edtorch.app.checkpoints import SavedJob, cut, warn_of
from edtorch.app.checks import at_least
from edtorch.app.errors import ConfigError
from edtorch.app.job import Job, Work
from edtorch.app.learners import Learners
from edtorch.app.offline import RecordedLearners, build_offline, is_offline
from edtorch.app.outputs import Keeper, open_sinks, save_learned, save_results
from edtorch.app.planned import PlannedLearners
from edtorch.app.random_search import RandomPolicies, build_search, is_rival, is_search
from edtorch.app.rivals import Rivals, build_rival
from edtorch.app.rundir import INTERRUPTED, PART, RunFolder
from edtorch.app.settings import Settings
from edtorch.app.signals import Interrupted, Stop
from edtorch.report.domain import RETURN
from edtorch.run.files import FileProblem
from edtorch.run.log import ConsoleSink, StderrHandler

logger = logging.getLogger("edtorch")


Begin = Callable[[Path | None], Work]
"""Begins the work of a run in a folder, or of one that has none yet."""


def planned(config: Settings) -> tuple[list[int], Begin]:
    """The seeds, and what begins the work that the configuration asks for.  Raises ConfigError."""
    at_least("log.checkpoint_wall", config.log.checkpoint_wall, 0)
    at_least("log.checkpoints", config.log.checkpoints, 1)
    for key in ("stops", "strike"):
        if config.told[key] and not is_planned(config):
            logger.warning(
                "told.%s: not used; only a search between trials models it (search=planned,"
                " search=population)",
                key,
            )
    if is_offline(config):
        offline = build_offline(config)
        return offline.setup.seeds, lambda folder: RecordedLearners(offline, config)
    if is_planned(config):
        if is_rival(config):
            raise ConfigError(
                f"rival={config.rival._target_}, search={config.search._target_}: expected one of"
                " the two"
            )
        planned_setup = build_planned(config)
        return planned_setup.seeds, lambda folder: PlannedLearners(planned_setup)
    if is_rival(config) and config.log.transitions:
        raise ConfigError("log.transitions=true: expected false with a rival, which keeps none")
    if is_rival(config) and is_search(config):
        search = build_search(config)
        return [search.seed], lambda folder: RandomPolicies(search)
    if is_rival(config):
        rival = build_rival(config)
        return rival.seeds, lambda folder: Rivals(rival)
    setup = build(config)
    return setup.seeds, lambda folder: Learners(setup, config, folder)


def _done(
    begin: Begin,
    config: Settings,
    run_folder: RunFolder,
    stop: Stop,
    began: float,
    console: Console,
    checkpoint: SavedJob | None,
) -> dict[str, Any]:
    """Learn, evaluate, write everything; returns the content of ``summary.json``."""
    folder = run_folder.path
    if checkpoint is not None:
        cut(folder, checkpoint.files, (PART,))  # before the recorder opens it
    work = begin(folder)
    job = Job(
        *(work, config, stop, console, Keeper(run_folder).keep),
        lambda work: save_learned(work, folder),
    )
    if checkpoint is not None:
        _restore(job, checkpoint, folder)
    if not run_folder.is_running:
        run_folder.go_on(config, work.ticks)
        if not work.holds_state:
            logger.warning("%s: does not hold its state, and begins anew", work.title)
    run_folder.add("computed", work.computed)
    run_folder.add("holds_state", work.holds_state)
    job.sinks, board = open_sinks(work, config, folder)
    if config.log.progress:
        job.sinks.append(ConsoleSink(console))
    job.timing.startup_s = time.monotonic() - began
    try:
        job.run()
        job.evaluate()
        summary = save_results(job, folder, board)
    finally:
        for sink in job.sinks:
            sink.close()
    for part in (*work.told(summary), f"run folder: {folder}"):
        console.print(part, soft_wrap=isinstance(part, str))
    return summary


def _restore(job: Job, checkpoint: SavedJob, folder: Path) -> None:
    """Put the job where the checkpoint was.  Raises ConfigError and FileProblem."""
    computed = job.work.computed
    if computed != checkpoint.computed:
        raise ConfigError(
            f"{checkpoint.path}: was {checkpoint.computed}, but here the run would be {computed},"
            " with other digits; expected the same packages and compute.native"
        )
    warn_of(checkpoint)
    cut(folder, checkpoint.files)
    try:
        job.restore(checkpoint.state, folder)
    except (ValueError, LookupError, TypeError) as error:
        raise FileProblem(f"{checkpoint.path}: does not fit the run ({error})") from error


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


def headline(summary: dict[str, Any]) -> float:
    """What a sweeper minimises: simulated seconds before the first success; where there is no such
    figure, minus the return; for a search those that a policy costs that always succeeds."""
    if "seconds_before_first_success" in summary:
        return float(summary["seconds_before_first_success"]["median"])
    if (returns := summary.get(RETURN, {}).get("median")) is not None:
        return -float(returns)
    cost = summary.get("simulated_seconds_per_goal_policy")
    return math.inf if cost is None else float(cost)


def run(config: Settings, folder: RunFolder, stop: Stop, began: float) -> dict[str, Any]:
    """The job from configuration to table; the folder says at any time what has become of it."""
    seeds, begin = planned(config)
    folder.begin(config, seeds)
    with folder.lock.held():
        return carry_out(begin, config, folder, stop, began, Console())


def carry_out(
    begin: Begin,
    config: Settings,
    folder: RunFolder,
    stop: Stop,
    began: float,
    console: Console,
    checkpoint: SavedJob | None = None,
) -> dict[str, Any]:
    """The same for a folder that is locked; checkpoint: where a run goes on that was begun
    before."""
    torch.set_num_threads(config.compute.threads)
    try:
        with _logging_to(folder.path):
            try:
                summary = _done(begin, config, folder, stop, began, console, checkpoint)
            except Exception:
                if folder.is_running:
                    logger.exception("failed")
                raise
    except (KeyboardInterrupt, SystemExit) as error:
        with stop.not_now():
            folder.end(*INTERRUPTED)
        if isinstance(error, SystemExit):
            raise
        raise Interrupted(f"saved in {folder.path}") from error
    except BaseException as error:
        with stop.not_now(), contextlib.suppress(OSError):
            folder.end("failed", f"{type(error).__name__}: {error}")
        raise
    with stop.not_now():
        folder.end("done")
    if stop.asked:
        raise Interrupted(f"the run in {folder.path} is complete")
    return summary
