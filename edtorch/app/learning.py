"""Learners, however they come by their experience: what their jobs have in common."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edtorch.app.build import Setup
from edtorch.app.evaluations import Evaluations, Learned
from edtorch.app.job import Job, Work
from edtorch.app.settings import Settings
from edtorch.app.summary import broken, snapshots_of
from edtorch.errors import CovarianceFloored
from edtorch.report.domain import Domain
from edtorch.report.statistics import evaluation_figures
from edtorch.run.episodes import Episode
from edtorch.run.log import Entry, spread_scalars
from edtorch.types import Parameters

logger = logging.getLogger("edtorch")


class Learning(Work):
    """The policies that it leaves are the best so far with ``eval.keep``."""

    def __init__(
        self, setup: Setup, config: Settings, learned: Learned, domain: Domain, title: str
    ) -> None:
        self.title, self.domain = title, domain
        self.seeds, self.budget, self.world = setup.seeds, setup.budget, setup.calm
        self.actor, self.observer = setup.learner.policy, setup.learner.observer
        self.card = setup.card
        self._learned = learned
        self._count: int = config.eval.episodes
        self._evaluations = Evaluations(setup, config, domain)
        self._snapshots = snapshots_of(domain)
        self.columns = self._snapshots.columns
        self._warned, self._floored = set[int](), set[int]()

    @property
    def seconds(self) -> float:
        """See ``Work``."""
        return self._learned.seconds

    @property
    def ticks(self) -> int:
        """See ``Work``."""
        return int(self._learned.learners.tick.sum())

    @property
    def parameters(self) -> Parameters:
        """See ``Work``."""
        return self._evaluations.to_save(self._learned)

    @property
    def episodes(self) -> Sequence[Episode]:
        """See ``Work``."""
        return self._learned.episodes

    @property
    def holds_state(self) -> bool:
        """See ``Work``."""
        return True

    def state(self) -> dict[str, Any]:
        """See ``Work``."""
        return {
            "evaluations": self._evaluations.state(),
            "warned": sorted(self._warned),
            "floored": sorted(self._floored),
        }

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``."""
        self._evaluations.restore(state["evaluations"])
        self._warned, self._floored = set(state["warned"]), set(state["floored"])

    def evaluate(self, job: Job) -> None:
        """Fresh episodes of each policy."""
        if self._count and not self._evaluations.is_fresh(self._learned):
            job.console.print(f"{self._count} fresh episodes for each policy...")
        last = self._evaluations.run(self._learned)
        figures = evaluation_figures(last.episodes, self.domain.measures, self.domain.words)
        scalars = spread_scalars("evaluation", figures)
        job.take(Entry(scalars=scalars, step=round(self.seconds)))

    def _warn(self) -> None:
        """One line for each learner in trouble, when that is first seen."""
        learned = self._learned
        for row, (place, tick) in broken(learned).items():
            if row not in self._warned:
                self._warned.add(row)
                logger.warning(
                    "seed %d: not finite in %s after %d sound ticks; such updates are skipped",
                    self.seeds[row],
                    place,
                    tick,
                )
        for row in (learned.first_floored >= 0).nonzero().flatten().tolist():
            if row not in self._floored:
                self._floored.add(row)
                logger.warning(
                    "seed %d: %s from step %d of the unroll on (tick %d or before): the covariance"
                    " was not positive semidefinite",
                    self.seeds[row],
                    CovarianceFloored.__name__,
                    int(learned.first_floored[row]),
                    learned.clock,
                )
