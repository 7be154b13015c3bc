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
from edtorch.app.job import Job, Work
from edtorch.app.learners import Learners
from edtorch.app.offline import RecordedLearners, build_offline, is_offline
from edtorch.app.outputs import open_sinks, save_learned, save_results
from edtorch.app.random_search import RandomPolicies, build_search, is_rival, is_search
from edtorch.app.rivals import Rivals, build_rival
from edtorch.app.rundir import RunFolder
from edtorch.app.settings import Settings
from edtorch.app.signals import Interrupted, Stop
from edtorch.report.domain import RETURN
from edtorch.run.log import ConsoleSink, StderrHandler

logger = logging.getLogger("edtorch")


Begin = Callable[[], Work]


def planned(config: Settings) -> tuple[list[int], Begin]:
    """The seeds, and what begins the work that the configuration asks for.  Raises ConfigError."""
    if is_offline(config):
        offline = build_offline(config)
        return offline.setup.seeds, lambda: RecordedLearners(offline, config)
    if is_rival(config) and config.log.transitions:
        raise ConfigError("log.transitions=true: expected false with a rival, which keeps none")
    if is_rival(config) and is_search(config):
        search = build_search(config)
        return [search.seed], lambda: RandomPolicies(search)
    if is_rival(config):
        rival = build_rival(config)
        return rival.seeds, lambda: Rivals(rival)
    setup = build(config)
    return setup.seeds, lambda: Learners(setup, config)


def _done(
    begin: Begin, config: Settings, run_folder: RunFolder, stop: Stop, began: float
) -> dict[str, Any]:
    """Learn, evaluate, write everything; returns the content of ``summary.json``."""
    console, work, folder = Console(), begin(), run_folder.path
    run_folder.add("computed", work.computed)
    sinks, board = open_sinks(work, config, folder)
    if config.log.progress:
        sinks.append(ConsoleSink(console))
    job = Job(
        *(work, config, stop, console, sinks),
        lambda work, ended: save_learned(work, folder, ended=ended),
    )
    job.timing.startup_s = time.monotonic() - began
    try:
        job.run()
        job.evaluate()
        summary = save_results(job, folder, board)
    finally:
        for sink in sinks:
            sink.close()
    for part in (*work.told(summary), f"run folder: {folder}"):
        console.print(part, soft_wrap=isinstance(part, str))
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
    torch.set_num_threads(config.compute.threads)
    folder.begin(config, seeds)
    try:
        with _logging_to(folder.path):
            try:
                summary = _done(begin, config, folder, stop, began)
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
