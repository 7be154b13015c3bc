"""The job behind ``edtorch-train offline=recorded``: learn from files, leave a run folder."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import torch
from rich.console import Console

from edtorch.app.build import Setup, build
from edtorch.app.checks import at_least
from edtorch.app.domain import described
from edtorch.app.errors import ConfigError, under
from edtorch.app.evaluations import Evaluation
from edtorch.app.inverse import has_inverse
from edtorch.app.random_search import is_rival
from edtorch.app.rundir import (
    CHECKPOINT,
    POLICY,
    SUMMARY,
    TRANSITIONS,
    json_text,
    settings_text,
)
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.summary import (
    Timing,
    broken,
    flat_settings,
    medians,
    result_figures,
    summary_table,
    timing_figures,
)
from edtorch.errors import CovarianceFloored
from edtorch.learner.learner import Learner
from edtorch.report.domain import Domain
from edtorch.report.milestones import milestone_figures
from edtorch.report.statistics import Spread, by_row
from edtorch.run.checkpoint import save_policy, write_atomically, write_text
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import evaluate
from edtorch.run.log import ConsoleSink, CsvSink, Sink, TensorBoardSink
from edtorch.run.milestones import FirstSuccess, checkpoint
from edtorch.run.offline import Lessons, Offline, learn
from edtorch.run.transitions_file import Invalid, Recorded, joined, load_transitions
from sims.base import Outcome

logger = logging.getLogger("edtorch")

_PIECE = 64
"""Transitions, or improvements, between two looks at whether to stop."""


@dataclass(frozen=True)
class OfflineSetup:
    """Everything that learning from files is made of; masked: what was wrong with their rows."""

    setup: Setup
    offline: Offline
    steps: int
    masked: list[str]


def is_offline(config: Any) -> bool:
    """Whether learners learn from recorded transitions.  Raises ConfigError."""
    return config.offline.variant == "recorded"


def _refuse_beside(config: Settings) -> None:
    """What makes no sense beside recorded transitions."""
    if is_rival(config):
        raise ConfigError("offline=recorded: expected rival=none; rivals do not learn from files")
    if has_inverse(config):
        raise ConfigError("offline=recorded: expected inverse=none, a learner of a forward model")
    if config.log.transitions:
        raise ConfigError("log.transitions=true: expected false with offline=recorded")
    if config.compute.compile == "on":
        raise ConfigError("compute.compile=on: expected auto or off with offline=recorded")
    if len(config.eval.minutes) or config.eval.keep:
        raise ConfigError(
            "offline=recorded: expected eval.minutes=[] and eval.keep=0; nothing is lived through"
        )


def _paths(data: Any) -> list[Path]:
    given = data if isinstance(data, list) else [data]
    if not given or not all(isinstance(each, str) and each for each in given):
        raise ConfigError(
            f"offline.data={data}: expected a file {TRANSITIONS}, the folder of a run with one,"
            " or a list of them"
        )
    paths = [Path(each) for each in given]
    return [path / TRANSITIONS if path.is_dir() else path for path in paths]


def _within(bounds: Any, setup: Setup) -> tuple[tuple[int, float], ...]:
    names = [q.name for q in setup.world.spec.state]
    for name, bound in bounds.items():
        if name not in names:
            raise ConfigError(f"offline.within.{name}={bound}: expected one of {', '.join(names)}")
        if not bound > 0:
            raise ConfigError(f"offline.within.{name}={bound}: expected a number > 0")
    return tuple((names.index(name), float(bound)) for name, bound in bounds.items())


def _load(config: Any, setup: Setup) -> tuple[Recorded, list[str]]:
    paths = _paths(config.data)
    if config.invalid not in get_args(Invalid):
        raise ConfigError(
            f"offline.invalid={config.invalid}: expected one of {', '.join(get_args(Invalid))}"
        )
    loaded = [load_transitions(p, setup.world.spec, config.invalid) for p in paths]
    data = joined([each.recorded for each in loaded])
    assert isinstance(setup.learner, Learner)
    dt = setup.world.dt
    if not setup.learner.model.integrates:
        other = data.dt[data.valid & ~_close(data.dt, dt)]
        if len(other):
            raise ConfigError(
                f"offline.data: has transitions of {other[0]:g} s, expected the domain's {dt:g} s:"
                " a model of the next state is one of the step as well; see model=derivative"
            )
    return data, [line for each in loaded for line in each.masked]


def _close(dt: Any, wanted: float) -> Any:
    return abs(dt - wanted) <= 1e-6 * wanted


def build_offline(config: Settings) -> OfflineSetup:
    """Objects for learning from files.  Raises ConfigError, and FileProblem for the files."""
    _refuse_beside(config)
    plain = config.merged({"compute": {"compile": "off"}})
    setup = build(plain)
    own = config.offline
    at_least("offline.steps", own.steps, 0)
    at_least("offline.tolerance", own.tolerance, 0)
    within = _within(own.within, setup)
    with under("offline"):
        lessons = Lessons(own.share, own.order, own.passes, within)
    data, masked = _load(own, setup)
    assert isinstance(setup.learner, Learner)
    with under("offline"):
        offline = Offline(
            setup.learner,
            setup.world,
            data,
            setup.seeds,
            lessons,
            setup.budget,
            schedule=setup.schedule if own.improve else None,
            tolerance=own.tolerance,
        )
    return OfflineSetup(setup, offline, own.steps, masked)


class _Report:
    """Rows of metrics on the way; it also looks for a stop."""

    def __init__(self, offline: Offline, sinks: list[Sink], stop: Stop, every: float) -> None:
        self._offline = offline
        self._sinks = sinks
        self._stop = stop
        self._every = every
        self._next = every

    def note(self) -> None:
        """After a piece."""
        if self._stop.asked:
            raise KeyboardInterrupt
        if self._offline.seconds >= self._next:
            self._next += self._every
            self.write([])

    def write(self, episodes: Sequence[Episode]) -> None:
        """A row for each learner now."""
        snapshot = self._offline.snapshot()
        for sink in self._sinks:
            sink.write(snapshot, episodes)


def _warn(offline: Offline) -> None:
    for row, (place, tick) in broken(offline).items():
        logger.warning(
            "seed %d: not finite in %s (%d sound transitions before it); such updates are skipped",
            offline.seeds[row],
            place,
            tick,
        )
    for row in (offline.first_floored >= 0).nonzero().flatten().tolist():
        logger.warning(
            "seed %d: %s from step %d of the unroll on: the covariance was not positive"
            " semidefinite",
            offline.seeds[row],
            CovarianceFloored.__name__,
            int(offline.first_floored[row]),
        )
    going = [s for s, on in zip(offline.seeds, offline.moving.tolist(), strict=True) if on]
    if going:
        logger.warning(
            "offline.steps: %d of %d policies were still moving after the last one",
            len(going),
            len(offline.seeds),
        )


def _save(folder: Path, offline: Offline) -> None:
    """What the learners know."""
    state = offline.learners
    content = {
        "seeds": offline.seeds,
        "clock": offline.clock,
        "learners": {name: getattr(state, name) for name in state.__dataclass_fields__},
    }
    write_atomically(folder / CHECKPOINT, lambda partial: torch.save(content, partial))


def _milestones(
    offline: Offline,
    fresh: Sequence[Sequence[Episode]],
    own: Sequence[Sequence[Episode]],
    domain: Domain,
    cpu_s: float,
) -> dict[str, Any]:
    """One checkpoint, at the end: what is paid is the data; own: the episodes in each seed's."""
    history = [
        [
            checkpoint(
                tried,
                domain.measures,
                seconds=seconds,
                failures=sum(e.outcome is Outcome.FAILED for e in lived),
                episodes=len(lived),
                cpu_s=cpu_s / len(fresh),
            )
        ]
        for tried, seconds, lived in zip(fresh, offline.experience, own, strict=True)
    ]
    return milestone_figures(history, offline.seeds, domain)


def _summary(
    job: OfflineSetup, domain: Domain, evaluation: Evaluation, timing: Timing
) -> dict[str, Any]:
    """The content of ``summary.json``: a learner's, all experience being that of the data."""
    offline, episodes = job.offline, evaluation.episodes
    seeds = offline.seeds
    own = by_row(offline.episodes, len(seeds))
    failures = [sum(e.outcome is Outcome.FAILED for e in each) for each in own]
    first = [
        FirstSuccess(any(e.success for e in fresh), paid, seconds, 0)
        for fresh, paid, seconds in zip(episodes, failures, offline.experience, strict=True)
    ]
    figures: dict[str, list[int]] = {
        "episodes": [len(each) for each in own],
        domain.words.failures: failures,
        "transitions_used": offline.used,
        "transitions_left_out": offline.unused,
        "steps": offline.steps.tolist(),
    }
    reached = {}
    if job.setup.world.spec.goal and any(episodes):
        told = evaluation.as_json(domain)
        reached = {"evaluations": [told], "final": told}
    if all(episodes):
        reached["milestones"] = _milestones(offline, episodes, own, domain, timing.cpu_s)
    return {
        **result_figures(domain, seeds, episodes, [], first),
        **reached,
        "offline": {
            **{name: Spread([*counts]).as_json() for name, counts in figures.items()},
            "masked": job.masked,
        },
        "simulated_seconds": offline.experience,
        **timing_figures(timing, offline),
    }


def run_offline(
    job: OfflineSetup, config: Settings, folder: Path, stop: Stop, console: Console, began: float
) -> dict[str, Any]:
    """Learn, evaluate, write everything; returns the content of ``summary.json``."""
    setup, offline = job.setup, job.offline
    title = f"{setup.world.spec.name}, {len(setup.seeds)} learners, from recorded transitions"
    logger.info("%s; %s", title, setup.path)
    for line in job.masked:
        logger.warning("masked: %s", line)
    timing = Timing(startup_s=time.monotonic() - began)
    domain = described(setup.world)
    sinks: list[Sink] = [CsvSink(folder, words=domain.words)]
    board = None
    if config.log.tensorboard:
        board = TensorBoardSink(folder, settings_text(config), domain.words)
        sinks.append(board)
    if config.log.progress:
        sinks.append(ConsoleSink(console, words=domain.words))
    report = _Report(offline, sinks, stop, config.log.every)
    wall, cpu = time.monotonic(), time.process_time()
    try:
        try:
            with stop.between_ticks():
                learn(offline, job.steps, report.note, _PIECE)
        finally:
            with stop.not_now():
                timing.wall_s = time.monotonic() - wall
                timing.cpu_s = time.process_time() - cpu
                timing.ticks = int(offline.learners.tick.sum())
                _save(folder, offline)
                acting = setup.learner.acting(offline.learners)
                save_policy(folder / POLICY, acting, setup.card)
        report.write(offline.episodes)
        _warn(offline)
        evaluation = _evaluated(job, config.eval.episodes, console, timing)
        summary = _summary(job, domain, evaluation, timing)
        if board is not None:
            board.hparams(flat_settings(config), medians(summary))
    finally:
        for sink in sinks:
            sink.close()
    write_text(folder / SUMMARY, json_text(summary))
    console.print(summary_table(summary, domain, title))
    console.print(f"run folder: {folder}", soft_wrap=True)
    return summary


def _evaluated(job: OfflineSetup, episodes: int, console: Console, timing: Timing) -> Evaluation:
    """Fresh episodes of each policy."""
    setup, began = job.setup, time.monotonic()
    minutes = math.fsum(job.offline.experience) / len(setup.seeds) / 60
    found: list[list[Episode]] = [[] for _ in setup.seeds]
    if episodes:
        console.print(f"{episodes} fresh episodes for each policy...")
        acting = setup.learner.acting(job.offline.learners)
        found = evaluate(setup.learner.policy, acting, setup.calm(), setup.seeds, episodes)
    timing.eval_s = time.monotonic() - began
    return Evaluation(minutes, found)
