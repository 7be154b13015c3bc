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
from edtorch.app.errors import ConfigError
from edtorch.app.job import Job
from edtorch.app.offline import build_offline, is_offline, run_offline
from edtorch.app.outputs import open_sinks, save_learned, save_results
from edtorch.app.random_search import build_search, is_rival, is_search, run_search
from edtorch.app.rivals import build_rival, run_rival
from edtorch.app.rundir import RunFolder
from edtorch.app.settings import Settings
from edtorch.app.signals import Interrupted, Stop
from edtorch.app.summary import never_succeeded, summary_table
from edtorch.report.domain import RETURN
from edtorch.run.log import StderrHandler

logger = logging.getLogger("edtorch")


def _train(job: Job, folder: Path, began: float) -> dict[str, Any]:
    """Learn, evaluate, write everything; returns the content of ``summary.json``."""
    timing, console = job.timing, job.console
    timing.startup_s = time.monotonic() - began
    sinks, board = open_sinks(job, folder)
    if job.config.log.progress:
        sinks.append(job.console_sink())
    try:
        job.learn(sinks, lambda job, ended: save_learned(job, folder, ended=ended))
        job.evaluate()
        summary = save_results(job, folder, board)
    finally:
        for sink in sinks:
            sink.close()
    domain = job.evaluations.domain
    console.print(summary_table(summary, domain, job.title))
    if (never := never_succeeded(summary, domain)) is not None:
        console.print(never, soft_wrap=True)
    console.print(
        f"learning {timing.wall_s:.1f} s ({timing.ticks_per_cpu_s:.0f} learner ticks per CPU s),"
        f" evaluation {timing.eval_s:.1f} s, pictures {timing.figures_s:.1f} s",
        soft_wrap=True,
    )
    console.print(f"run folder: {folder}", soft_wrap=True)
    return summary


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
    config: Settings, folder: RunFolder, stop: Stop, began: float
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
    return setup.seeds, lambda: _train(Job(setup, config, stop, Console()), folder.path, began)


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
            folder.set_status("interrupted", "stopped by a signal; the state at that time is saved")
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
