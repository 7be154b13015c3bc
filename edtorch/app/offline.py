"""Learning from files, ``edtorch-train offline=recorded``."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from rich.table import Table

from edtorch.app.budget import given_budget
from edtorch.app.build import Setup, build
from edtorch.app.checks import at_least
from edtorch.app.compute import refuse_kernels
from edtorch.app.domain import described
from edtorch.app.errors import ConfigError, under
from edtorch.app.inverse import has_inverse
from edtorch.app.job import Job
from edtorch.app.learning import Learning
from edtorch.app.random_search import is_rival
from edtorch.app.rundir import TRANSITIONS
from edtorch.app.settings import Settings
from edtorch.app.summary import not_finite, result_figures, summary_table
from edtorch.learner.learner import Learner
from edtorch.report.domain import Domain
from edtorch.report.milestones import milestone_figures
from edtorch.report.statistics import Spread, by_row
from edtorch.run.episodes import Budget, Episode
from edtorch.run.milestones import FirstSuccess, checkpoint
from edtorch.run.offline import Lessons, Offline
from edtorch.run.transitions_file import Invalid, Loaded, joined, load_transitions
from edtorch.told_apart import told_apart
from sims.base import Outcome

logger = logging.getLogger("edtorch")

_PIECE = 64
"""Transitions, or improvements, between two looks at whether to stop."""


_REASONS = {
    "other_seeds": "of other seeds",
    "not_drawn": "not drawn",
    "budget": "beyond the budget",
    "masked": "masked",
    "within": "beyond offline.within",
}
"""The fields of ``edtorch.run.offline.Unused`` in words."""
_OWN = ("budget", "masked", "within")
"""Those that concern a learner's own share of the data."""


@dataclass(frozen=True)
class OfflineSetup:
    """Everything that learning from files is made of; budget: None where the data are used whole;
    masked: what was wrong with rows that are left out; doubts: what is odd about the others."""

    setup: Setup
    budget: Budget | None
    offline: Offline
    steps: int
    masked: list[str]
    doubts: list[str]


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
    refuse_kernels(config.compute, "offline=recorded")
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
    for path in paths:
        if not path.exists():
            raise ConfigError(f"offline.data={path}: no such file or folder")
    return [path / TRANSITIONS if path.is_dir() else path for path in paths]


def _within(bounds: Any, setup: Setup) -> tuple[tuple[int, float], ...]:
    names = [q.name for q in setup.world.spec.state]
    for name, bound in bounds.items():
        if name not in names:
            raise ConfigError(f"offline.within.{name}={bound}: expected one of {', '.join(names)}")
        if not bound > 0:
            raise ConfigError(f"offline.within.{name}={bound}: expected a number > 0")
    return tuple((names.index(name), float(bound)) for name, bound in bounds.items())


def _load(config: Any, setup: Setup) -> Loaded:
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
            found, wanted = told_apart(float(other[0]), dt)
            raise ConfigError(
                f"offline.data: has transitions of {found} s, expected the domain's {wanted} s:"
                " a model of the next state is one of the step as well; see model=derivative"
            )
    masked = [line for each in loaded for line in each.masked]
    return Loaded(data, masked, [line for each in loaded for line in each.doubts])


def _close(dt: Any, wanted: float) -> Any:
    return abs(dt - wanted) <= 1e-6 * wanted


def build_offline(config: Settings) -> OfflineSetup:
    """Objects for learning from files.  Raises ConfigError, and FileProblem for the files."""
    _refuse_beside(config)
    budget = given_budget(config.train)
    setup = build(config, budget or Budget(seconds=math.inf))
    own = config.offline
    at_least("offline.steps", own.steps, 0)
    at_least("offline.tolerance", own.tolerance, 0)
    within = _within(own.within, setup)
    with under("offline"):
        lessons = Lessons(own.share, own.order, own.passes, within)
    loaded = _load(own, setup)
    assert isinstance(setup.learner, Learner)
    with under("offline"):
        offline = Offline(
            setup.learner,
            setup.world,
            loaded.recorded,
            setup.seeds,
            lessons,
            budget,
            schedule=setup.schedule if own.improve else None,
            tolerance=own.tolerance,
        )
    return OfflineSetup(setup, budget, offline, own.steps, loaded.masked, loaded.doubts)


def _told_use(offline: Offline) -> str:
    """How much of the data the learners learn from, and why not from the rest."""
    used = Spread([*offline.used])
    reasons = [
        f"{_range(counts)} {words}"
        for reason, words in _REASONS.items()
        if any(counts := [getattr(each, reason) for each in offline.unused])
    ]
    rest = f"; left out: {', '.join(reasons)}" if reasons else ""
    return f"transitions of each learner: {_range(used.known)} learned from{rest}"


def _range(counts: Sequence[float]) -> str:
    least, most = min(counts), max(counts)
    return f"{least:.0f}" if least == most else f"{least:.0f} to {most:.0f}"


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


class RecordedLearners(Learning):
    """Learners of recorded transitions."""

    def __init__(self, job: OfflineSetup, config: Settings) -> None:
        setup, self._offline = job.setup, job.offline
        self._steps, self._masked, self._doubts = job.steps, job.masked, job.doubts
        self._log_every: float = config.log.every
        self._due = self._log_every
        self._cpu_s = 0.0
        title = f"{setup.world.spec.name}, {len(setup.seeds)} learners, from recorded transitions"
        super().__init__(setup, config, job.offline, described(setup.world), title)
        self.notes = [f"{title}; {setup.path}", _told_use(job.offline)]
        self.budget, self.measures = job.budget, []

    def run(self, job: Job) -> None:
        """All transitions, then the improvements; a report every ``log.every`` seconds of data."""
        for line in self._masked:
            logger.warning("masked: %s", line)
        for line in self._doubts:
            logger.warning("%s", line)
        for _ in self._offline.learn(self._steps, _PIECE):
            if self.seconds >= self._due:
                self._due += self._log_every
                job.take(self._snapshots.entry(self._offline.snapshot(), []))
            # After the report, so that no report is pending in the saved state.
            job.whole()
        job.keep()
        job.take(self._snapshots.entry(self._offline.snapshot(), self.episodes))
        self._warn()

    def state(self) -> dict[str, Any]:
        """See ``Work``."""
        return {**super().state(), "offline": self._offline.state(), "due": self._due}

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``."""
        super().restore(state, folder)
        self._offline.restore(state["offline"])
        self._due = state["due"]

    def _warn(self) -> None:
        """Also of policies that have not arrived."""
        super()._warn()
        going = int(self._offline.moving.sum())
        if going:
            logger.warning(
                "offline.steps: %d of %d policies were still moving after the last one",
                going,
                len(self.seeds),
            )

    def evaluate(self, job: Job) -> None:
        """Fresh episodes of each policy."""
        super().evaluate(job)
        self._cpu_s = job.timing.cpu_s

    def summary(self) -> dict[str, Any]:
        """A learner's, all experience being that of the data."""
        offline, domain = self._offline, self.domain
        self._evaluations.leave_out(offline)
        episodes = self._evaluations.done[-1].episodes
        own = by_row(offline.episodes, len(self.seeds))
        failures = [sum(e.outcome is Outcome.FAILED for e in each) for each in own]
        first = [
            FirstSuccess(any(e.success for e in fresh), paid, seconds, 0)
            for fresh, paid, seconds in zip(episodes, failures, offline.experience, strict=True)
        ]
        left = {k: [getattr(each, k) for each in offline.unused] for k in _REASONS}
        figures: dict[str, list[int]] = {
            "episodes": [len(each) for each in own],
            domain.words.failures: failures,
            "transitions_used": offline.used,
            "transitions_left_out": [sum(left[k][row] for k in _OWN) for row in range(len(own))],
            "steps": offline.steps.tolist(),
        }
        reached = self._evaluations.as_json()
        if all(episodes):
            reached["milestones"] = _milestones(offline, episodes, own, domain, self._cpu_s)
        return {
            **result_figures(domain, self.seeds, episodes, [], first),
            **reached,
            "offline": {
                **{name: Spread([*counts]).as_json() for name, counts in figures.items()},
                "left_out": {name: Spread([*counts]).as_json() for name, counts in left.items()},
                "masked": self._masked,
                "warnings": self._doubts,
            },
            "simulated_seconds": offline.experience,
            "not_finite": not_finite(offline),
        }

    def told(self, summary: dict[str, Any]) -> list[Table | str]:
        """Figures over the seeds."""
        return [summary_table(summary, self.domain, self.title), _told_use(self._offline)]
