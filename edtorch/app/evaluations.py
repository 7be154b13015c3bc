"""Fresh episodes on the way: how good the policies are after so many minutes of learning."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor

from edtorch.app.best import Kept, better
from edtorch.app.build import Setup
from edtorch.app.compute import evaluation_mode
from edtorch.app.settings import Settings
from edtorch.app.solved import build_solved_rate, checkpoint_solved
from edtorch.app.trials import SCREENING, Paid, Trials
from edtorch.native.evaluation import Mode, evaluate_policies
from edtorch.report.domain import Domain
from edtorch.report.legacy import MINUTES
from edtorch.report.milestones import checkpoint_figures, milestone_figures
from edtorch.report.quantities import EVALUATION, evaluation, told_of
from edtorch.report.statistics import Spread, evaluation_figures
from edtorch.report.text import number
from edtorch.run.episodes import Episode, nested_of, nested_state
from edtorch.run.milestones import MILESTONES
from edtorch.run.random import Purpose
from edtorch.types import LearnerState, Parameters


@dataclass(frozen=True)
class Evaluation:
    """The fresh episodes of each policy after ``minutes`` simulated minutes of learning."""

    minutes: float
    episodes: list[list[Episode]]

    def as_json(self, domain: Domain) -> dict[str, Any]:
        """For ``summary.json``."""
        figures = evaluation_figures(self.episodes, domain.measures, domain.words)
        return {MINUTES: self.minutes, **figures}


@dataclass(frozen=True)
class News:
    """Of an evaluation on the way; text: for the console; figures: spreads over the seeds."""

    minutes: float
    text: str
    figures: dict[str, Any]


class Learned(Protocol):
    """Learners that have learned, however they came by their experience."""

    seeds: list[int]
    clock: int

    @property
    def seconds(self) -> float:
        """Of the learner that has lived longest."""
        ...

    @property
    def learners(self) -> LearnerState:
        """What they know."""
        ...

    @property
    def episodes(self) -> list[Episode]:
        """Of all of them."""
        ...

    @property
    def finite(self) -> Tensor:
        """``[3, B]``: see ``edtorch.learner.learner.Check``."""
        ...

    @property
    def first_floored(self) -> Tensor:
        """``[B]``: the step of an unroll from which on a covariance first had to be floored, or
        -1."""
        ...

    def counts(self, row: int) -> tuple[int, int]:
        """Episodes and failures of a learner."""
        ...


class Evaluations:
    """Evaluates when it is time; ``cpu_s`` is what that has taken so far.

    After each of ``eval.minutes`` the policies are tried for the milestones.  In a family of tasks
    (``Spec.goal``), and with ``eval.keep``, each policy runs all its fresh episodes and every
    evaluation is reported; elsewhere as ``Trials`` does, and only what has learned since its last
    trial and has not been at every milestone yet.

    Whether a task is solved (``eval.solved``) is judged then and at the end, in other episodes.

    done: the evaluations in full; kept: with ``eval.keep``, the best policies so far, judged by as
    many further episodes; trials: None without ``eval.minutes`` and ``eval.solved``.
    """

    def __init__(self, setup: Setup, config: Settings, domain: Domain) -> None:
        self._setup = setup
        self._native: Mode = evaluation_mode(config)
        self._episodes: int = config.eval.episodes
        self._judged: int = config.eval.keep
        minutes = config.eval.minutes if self._episodes else []
        self._due = sorted({max(1, round(60 * m / setup.world.dt)) for m in minutes})
        self._solved = solved = build_solved_rate(config)
        self._in_full = bool(setup.world.spec.goal) or self._judged > 0
        self.domain = domain
        self.done: list[Evaluation] = []
        self.kept: Kept | None = None
        size = len(setup.seeds)
        self._parameters: Parameters = {}
        self._among: Sequence[Episode] = ()
        screening = self._episodes if solved.asked else SCREENING
        parts = (size, self._episodes, self._tried, self.domain.measures)
        tried = bool(self._due) or solved.asked
        self.trials = Trials(*parts, screening=screening) if tried else None
        self._clock = -1
        self.cpu_s = 0.0
        self._began = time.process_time()
        self._ticks = [0] * size
        self._tried_at = [0] * size
        self._paid_cpu_s = [0.0] * size

    def next_after(self, clock: int, other: int) -> int:
        """The tick of the next evaluation after ``clock``, or ``other`` if that comes before."""
        return min([other, *(tick for tick in self._due if tick > clock)])

    def state(self) -> dict[str, Any]:
        """What the evaluations to come, and the figures of all of them, depend on."""
        return {
            "done": [
                {"minutes": each.minutes, "episodes": nested_state(each.episodes)}
                for each in self.done
            ],
            "kept": None if self.kept is None else self.kept.state(),
            "trials": None if self.trials is None else self.trials.state(),
            "clock": self._clock,
            "ticks": self._ticks,
            "tried_at": self._tried_at,
            "paid_cpu_s": self._paid_cpu_s,
            "cpu_s": self.cpu_s,
            "uncharged_cpu_s": self._uncharged(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from the state of others of the same settings."""
        self.done = [
            Evaluation(each["minutes"], nested_of(each["episodes"])) for each in state["done"]
        ]
        self.kept = None if state["kept"] is None else Kept.of(state["kept"])
        if self.trials is not None:
            self.trials.restore(state["trials"])
        self._clock = state["clock"]
        self._ticks, self._tried_at = list(state["ticks"]), list(state["tried_at"])
        self._paid_cpu_s, self.cpu_s = list(state["paid_cpu_s"]), state["cpu_s"]
        self._began = 0.0
        self._began = self._uncharged() - state["uncharged_cpu_s"]

    def run_if_due(self, training: Learned) -> News | None:
        """Evaluate if this is the tick for it."""
        if training.clock not in self._due:
            return None
        minutes = training.seconds / 60
        if self._in_full:
            figures = self.run(training).as_json(self.domain)
            del figures[MINUTES]
            told = [
                f"{q.label.removeprefix(EVALUATION)} {number(figures[q.path[0]]['median'])}"
                for q in told_of(self.domain, figures, evaluation(self.domain))
            ]
        else:
            figures, told = self._try(training)
        return News(minutes, ", ".join(told), figures)

    def is_fresh(self, training: Learned) -> bool:
        """Whether there has been one in full at this very tick."""
        return self._clock == training.clock

    def run(self, training: Learned) -> Evaluation:
        """Evaluate now and in full, unless that has just been done."""
        if self.is_fresh(training):
            return self.done[-1]
        self._charge(training)
        cpu = time.process_time()
        episodes, minutes = [[] for _ in training.seeds], training.seconds / 60
        if self._episodes:
            count = self._episodes
            self._look_at(training)
            found = self._fresh(range(len(training.seeds)), count + self._judged)
            episodes = [own[:count] for own in found]
            if self._judged:
                judged = [own[count:] for own in found]
                self.kept = better(self.kept, self._parameters, minutes, judged, episodes)
        if self.trials is not None:
            rows = self._changed()
            if self._solved.asked:
                self.trials.run(rows, lambda row: self._paid(training, row))
            else:
                for row in rows:
                    self.trials.record(row, episodes[row], self._paid(training, row))
            self._tried_at = list(self._ticks)
        self._clock = training.clock
        self.done.append(Evaluation(minutes, episodes))
        self.cpu_s += time.process_time() - cpu
        return self.done[-1]

    def leave_out(self, training: Learned) -> None:
        """Close a run that was interrupted, without episodes."""
        if not self.done:
            self.done.append(Evaluation(training.seconds / 60, [[] for _ in training.seeds]))

    def _try(self, training: Learned) -> tuple[dict[str, Any], list[str]]:
        """For the milestones alone: figures of the last trials, and how many have been where."""
        assert self.trials is not None
        self._charge(training)
        cpu = time.process_time()
        self._look_at(training)
        there = [all(own) for own in zip(*map(self.trials.reached, MILESTONES), strict=True)]
        rows = [row for row in self._changed() if not there[row]]
        self.trials.run(rows, lambda row: self._paid(training, row))
        for row in rows:
            self._tried_at[row] = self._ticks[row]
        last = [own[-1] for own in self.trials.history]
        figures = {
            "failure_rate": Spread([c.failure_rate for c in last]).as_json(),
            "goal_rate": Spread([c.goal_rate for c in last]).as_json(),
        }
        size = len(last)
        told = [f"{name} {sum(self.trials.reached(name))} of {size}" for name in MILESTONES]
        self.cpu_s += time.process_time() - cpu
        return figures, told

    def _tried(self, rows: Sequence[int], count: int) -> list[list[Episode]]:
        """For the trials: what decides whether a task is solved does not report how well."""
        purpose = Purpose.SOLVED if self._solved.asked else Purpose.EVALUATION
        return self._fresh(rows, count, purpose)

    def _fresh(
        self, rows: Sequence[int], count: int, purpose: Purpose = Purpose.EVALUATION
    ) -> list[list[Episode]]:
        picked = {name: p[list(rows)] for name, p in self._parameters.items()}
        seeds = [self._setup.seeds[row] for row in rows]
        # A world of its own: one that wraps a simulator is still in its last episode.
        learner, world = self._setup.learner, self._setup.calm()
        return evaluate_policies(
            learner.policy,
            picked,
            world,
            seeds,
            count,
            native=self._native,
            observer=learner.observer,
            among=self._among,
            purpose=purpose,
        )

    def _look_at(self, training: Learned) -> None:
        """What ``_fresh`` needs of it: the policies, and the episodes of the run."""
        self._parameters = self._setup.learner.acting(training.learners)
        self._among = training.episodes

    def _charge(self, training: Learned) -> None:
        """Share the CPU seconds of learning since the last call out among those who lived."""
        spent = self._uncharged()
        ticks = training.learners.tick.tolist()
        lived = [now - before for now, before in zip(ticks, self._ticks, strict=True)]
        for row, own in enumerate(lived):
            self._paid_cpu_s[row] += spent * own / max(1, sum(lived))
        self._ticks = ticks

    def _uncharged(self) -> float:
        """CPU seconds of learning that are nobody's yet."""
        return time.process_time() - self._began - self.cpu_s - sum(self._paid_cpu_s)

    def _changed(self) -> list[int]:
        """Rows that have learned since they were last tried, or never were."""
        assert self.trials is not None
        return [
            row
            for row, (now, then) in enumerate(zip(self._ticks, self._tried_at, strict=True))
            if now > then or not self.trials.history[row]
        ]

    def _paid(self, training: Learned, row: int) -> Paid:
        episodes, failures = training.counts(row)
        return Paid(
            seconds=self._ticks[row] * self._setup.world.dt,
            episodes=episodes,
            failures=failures,
            cpu_s=self._paid_cpu_s[row],
        )

    def as_json(self) -> dict[str, Any]:
        """For ``summary.json``: every evaluation where each is reported, the last one once more as
        ``final``; that of the policies kept; milestones."""
        figures: dict[str, Any] = {}
        if self._in_full and self._episodes:
            figures["evaluations"] = [each.as_json(self.domain) for each in self.done]
            figures["final"] = figures["evaluations"][-1]
        if self.kept is not None:
            figures["kept"] = self.kept.as_json(self.domain)
        return figures | self._milestones()

    def _milestones(self) -> dict[str, Any]:
        if self.trials is None or not all(self.trials.history):
            return {}
        history = self.trials.history
        return {
            "milestones": milestone_figures(history, self._setup.seeds, self.domain),
            "checkpoints": checkpoint_figures(history, self.domain),
            **checkpoint_solved(history, self._solved, self._setup.seeds),
        }

    def to_save(self, training: Learned) -> Parameters:
        """The policies that the run saves: the best ones if kept, else the current ones."""
        if self.kept is None:
            return self._setup.learner.acting(training.learners)
        return self.kept.parameters
