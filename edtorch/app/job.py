"""One job for every method: run to the end, evaluate, keep the results in memory.

``edtorch-train`` writes them to a run folder, ``edtorch.learn`` hands them to its caller.
"""

from __future__ import annotations

import contextlib
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from edtorch.app.rundir import command_line, versions
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.summary import Timing
from edtorch.learner.learner import Actor
from edtorch.learner.observer import Observer
from edtorch.run.checkpoint import PolicyCard
from edtorch.run.episodes import Budget, Episode
from edtorch.run.log import Entry, Sink
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

logger = logging.getLogger("edtorch")


class Work(ABC):
    """What a job does: learners, learners of recorded transitions, rivals, or a random search.

    title: for people; notes: what to say at the start; computed: whether its ticks are compiled,
    in words; seeds: one learner or search each; budget:
    of each, None where there is none; columns: of ``metrics.csv``; measures: the sim's own that
    ``episodes.csv`` has, None: there is no such file; actor, observer, card: of its policies;
    world: makes one to evaluate them in.
    """

    title: str
    notes: Sequence[str] = ()
    computed: str = "uncompiled"
    seeds: list[int]
    budget: Budget | None = None
    columns: Sequence[str]
    measures: Sequence[str] | None = None
    actor: Actor
    observer: Observer | None = None
    card: PolicyCard
    world: Callable[[], World]

    @property
    @abstractmethod
    def seconds(self) -> float:
        """Simulated, until now, of the seed that has lived longest."""

    @property
    @abstractmethod
    def ticks(self) -> int:
        """Until now, of all seeds."""

    @property
    @abstractmethod
    def parameters(self) -> Parameters:
        """Of the policies that the run leaves, each ``[S, ...]``."""

    @property
    def stored(self) -> Parameters:
        """What is saved of them."""
        return self.parameters

    @property
    def episodes(self) -> Sequence[Episode]:
        """Those of the learning that are kept."""
        return ()

    @abstractmethod
    def run(self, job: Job) -> None:
        """Learn to the end; ``job`` takes what there is to report and says when to stop."""

    def evaluate(self, job: Job) -> None:
        """Evaluate the policies at the end, unless that has just been done."""
        return

    def state(self) -> dict[str, Any] | None:
        """Everything that the rest of the work depends on, for ``edtorch.run.state_file``.

        None: the method does not hold its state, and a run of it can only begin anew.
        """
        return None

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """Go on from a state of work with the same settings, of the run in ``folder``.

        Raises ValueError where the state does not fit.
        """
        raise NotImplementedError

    def save(self, folder: Path, *, ended: bool) -> None:
        """Write files of its own, beside the policies; ended: nothing more will be learned."""
        return

    def draw(self, folder: Path, *, animate: bool) -> Figure | None:
        """Write the pictures; returns the learning curve, None where there is none."""
        return None

    @abstractmethod
    def summary(self) -> dict[str, Any]:
        """Its part of ``summary.json``."""

    @abstractmethod
    def told(self, summary: dict[str, Any]) -> Sequence[Table | str]:
        """The summary for the terminal."""


class _Stopped(Exception):
    """A stop was requested, and the last tick is complete."""


class Job:
    """One run: ``run``, ``evaluate``, and then ``summary`` and the policies of ``work``.

    config: what the work was built from; stop: looked at between ticks; console: gets the lines on
    the way; sinks: get the entries; save: called with the work every ``log.checkpoint`` simulated
    seconds (False), and however learning ends (True).
    """

    def __init__(
        self,
        work: Work,
        config: Settings,
        stop: Stop,
        console: Console,
        sinks: Sequence[Sink],
        save: Callable[[Work, bool], None],
    ) -> None:
        self.work = work
        self.config = config
        self.console = console
        self.timing = Timing()
        self._stop = stop
        self._sinks = sinks
        self._save = save
        self._next_save = config.log.checkpoint
        self._eval_cpu_s = 0.0
        for note in work.notes:
            logger.info("%s", note)

    def run(self) -> None:
        """Learn.  Raises KeyboardInterrupt, after the tick, if a stop was requested."""
        wall, cpu = time.monotonic(), time.process_time()
        work, timing = self.work, self.timing
        try:
            with self._stop.between_ticks(), contextlib.suppress(_Stopped):
                work.run(self)
        finally:
            with self._stop.not_now():
                timing.wall_s = time.monotonic() - wall - timing.eval_s
                timing.cpu_s = time.process_time() - cpu - self._eval_cpu_s
                timing.ticks = work.ticks
                self._save(work, True)
        if self._stop.asked:
            raise KeyboardInterrupt

    def pause(self) -> None:
        """Called by the work between ticks; raises what ends it if a stop was requested."""
        if self._stop.asked:
            raise _Stopped

    def take(self, entry: Entry) -> None:
        """Report what the work has done since the last time; saves if it is time."""
        for sink in self._sinks:
            sink.write(entry)
        if entry.news:
            self.console.print(entry.news, soft_wrap=True, highlight=False)
        if self.work.seconds >= self._next_save:
            self._save(self.work, False)
            self._next_save += self.config.log.checkpoint

    def evaluate(self) -> None:
        """Run the evaluation at the end."""
        with self.evaluation():
            self.work.evaluate(self)

    @contextlib.contextmanager
    def evaluation(self) -> Iterator[None]:
        """What the work does meanwhile does not count as learning."""
        wall, cpu = time.monotonic(), time.process_time()
        yield
        self.timing.eval_s += time.monotonic() - wall
        self._eval_cpu_s += time.process_time() - cpu

    def summary(self) -> dict[str, Any]:
        """The content of ``summary.json``."""
        made_by = {"versions": versions(), "command": command_line()}
        return {**self.timing.as_json(), **self.work.summary(), **made_by}
