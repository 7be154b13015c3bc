"""Fresh episodes on the way: how good the policies are after so many minutes of learning."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from omegaconf import DictConfig

from edtorch.app.build import Setup
from edtorch.app.keeping import Kept, better
from edtorch.evaluation import evaluate
from edtorch.interact import Training
from edtorch.records import Episode
from edtorch.report.statistics import goal_figures
from edtorch.types import Parameters


@dataclass(frozen=True)
class Evaluation:
    """The fresh episodes of each policy after ``minutes`` simulated minutes of learning."""

    minutes: float
    episodes: list[list[Episode]]

    def as_json(self) -> dict[str, Any]:
        """For ``summary.json``."""
        return {"minutes": self.minutes, **goal_figures(self.episodes)}


class Evaluations:
    """Evaluates when it is time; ``wall_s`` and ``cpu_s`` are what that has taken so far.

    kept: with ``eval.keep``, the best policies so far, judged by as many further episodes.
    """

    def __init__(self, setup: Setup, config: DictConfig) -> None:
        self._setup = setup
        self._episodes: int = config.eval.episodes
        self._judged: int = config.eval.keep
        minutes = config.eval.minutes if self._episodes else []
        self._due = sorted({max(1, round(60 * m / setup.world.dt)) for m in minutes})
        self.done: list[Evaluation] = []
        self.kept: Kept | None = None
        self._clock = -1
        self.wall_s = self.cpu_s = 0.0

    def ticks_ahead(self, clock: int, most: int) -> int:
        """How many ticks may be run before the next evaluation, ``most`` at most."""
        later = [tick - clock for tick in self._due if tick > clock]
        return min([most, *later])

    def run_if_due(self, training: Training) -> Evaluation | None:
        """Evaluate if this is the tick for it."""
        return self.run(training) if training.clock in self._due else None

    def is_fresh(self, training: Training) -> bool:
        """Whether there has been one at this very tick."""
        return self._clock == training.clock

    def run(self, training: Training) -> Evaluation:
        """Evaluate now, unless it has just been done."""
        if self.is_fresh(training):
            return self.done[-1]
        wall, cpu = time.monotonic(), time.process_time()
        learner = self._setup.learner
        # A world of its own: one that wraps a simulator is still in its last episode.
        episodes, minutes = [[] for _ in training.seeds], training.seconds / 60
        if self._episodes:
            parameters, count = learner.acting(training.learners), self._episodes
            found = evaluate(
                learner.policy,
                parameters,
                self._setup.calm(),
                training.seeds,
                count + self._judged,
                observer=learner.observer,
            )
            episodes = [own[:count] for own in found]
            if self._judged:
                judged = [own[count:] for own in found]
                self.kept = better(self.kept, parameters, minutes, judged, episodes)
        self._clock = training.clock
        self.done.append(Evaluation(minutes, episodes))
        self.wall_s += time.monotonic() - wall
        self.cpu_s += time.process_time() - cpu
        return self.done[-1]

    def to_save(self, training: Training) -> Parameters:
        """The policies that the run is to leave: those kept, or those of now."""
        if self.kept is None:
            return self._setup.learner.acting(training.learners)
        return self.kept.parameters
