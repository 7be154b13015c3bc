"""One job for every method: run to the end, evaluate, keep the results in memory.

``edtorch-train`` writes them to a run folder, ``edtorch.learn`` hands them to its caller.
"""

from __future__ import annotations

import contextlib
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from edtorch.app.rundir import command_line, versions
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.summary import Timing
from edtorch.learner.learner import Actor
from edtorch.policy.memory import EpisodeMemory
from edtorch.run.episodes import Budget, Episode
from edtorch.run.log import Entry, Sink
from edtorch.run.policy_file import PolicyCard
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
    observer: EpisodeMemory | None = None
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
    def holds_state(self) -> bool:
        """Whether ``state`` and ``restore`` are implemented; else a run can only begin anew."""
        return False

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
        """Everything that the rest of the work depends on, for ``edtorch.run.state_file``; None
        unless ``holds_state``."""
        return None

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """Go on from a state of work with the same settings, of the run in ``folder``.

        Raises ValueError where the state does not fit.
        """
        raise NotImplementedError

    def flush(self, folder: Path) -> Sequence[Path]:
        """Have its own files in ``folder`` that are only appended to hold what there is; returns
        them."""
        return ()

    def save(self, folder: Path) -> None:
        """Write files of its own, beside the policies, when learning is over."""
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


CHECKPOINT_SHARE = 0.02
"""Of the time of learning that the saving of states may take."""


class Job:
    """One run: ``run``, ``evaluate``, and then ``summary`` and the policies of ``work``.

    config: what the work was built from; stop: looked at between ticks; console: gets the lines on
    the way; ``sinks``: get the entries; keep: called with the job to save ``state()``, every
    ``log.checkpoint_wall`` seconds and before the process may end; over: called with the work
    however learning ends.
    """

    def __init__(
        self,
        work: Work,
        config: Settings,
        stop: Stop,
        console: Console,
        keep: Callable[[Job], None],
        over: Callable[[Work], None],
    ) -> None:
        self.work = work
        self.config = config
        self.console = console
        self.sinks: list[Sink] = []
        self.timing = Timing()
        self._stop = stop
        self._keep = keep
        self._over = over
        self._next_keep = 0.0
        self._clocks = Clocks()

    def state(self) -> dict[str, Any]:
        """What the rest of the job depends on; of work that holds its state."""
        return {"work": self.work.state(), "timing": asdict(self._timed())}

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """Go on from the state of another job of the same settings, of the run in ``folder``.

        Raises ValueError where it does not fit.
        """
        self.work.restore(state["work"], folder)
        self.timing = Timing(**{**state["timing"], "startup_s": self.timing.startup_s})

    def run(self) -> None:
        """Learn.  Raises KeyboardInterrupt, after the tick, if a stop was requested."""
        for note in self.work.notes:
            logger.info("%s", note)
        self._clocks = Clocks()
        try:
            with self._stop.between_ticks(), contextlib.suppress(_Stopped):
                self.whole()
                self.work.run(self)
        finally:
            with self._stop.not_now():
                self.timing, self._clocks = self._timed(), Clocks()
                self._over(self.work)
        if self._stop.asked:
            raise KeyboardInterrupt

    def _timed(self) -> Timing:
        """``timing`` with what learning has taken until now."""
        wall, cpu = self._clocks.passed()
        timing, ticks = self.timing, self.work.ticks
        return replace(timing, wall_s=timing.wall_s + wall, cpu_s=timing.cpu_s + cpu, ticks=ticks)

    def pause(self) -> None:
        """Called by the work between ticks; raises what ends it if a stop was requested."""
        if self._stop.waiting:
            self._next_keep = 0.0
            self._stop.hand_on()
        if self._stop.asked:
            raise _Stopped

    def whole(self) -> None:
        """Called by the work wherever ``state`` is whole: saves it if it is time; as ``pause``."""
        if self._stop.asked or self._stop.waiting or time.monotonic() >= self._next_keep:
            self.keep()
        self._stop.hand_on()
        if self._stop.asked:
            raise _Stopped

    def keep(self) -> None:
        """Save the state, now."""
        began = time.monotonic()
        with self._stop.not_now():
            self._keep(self)
        now = time.monotonic()
        least = (now - began) / CHECKPOINT_SHARE
        self._next_keep = now + max(self.config.log.checkpoint_wall, least)

    def take(self, entry: Entry) -> None:
        """Report what the work has done since the last time."""
        for sink in self.sinks:
            sink.write(entry)
        if entry.news:
            self.console.print(entry.news, soft_wrap=True, highlight=False)

    def evaluate(self) -> None:
        """Run the evaluation at the end."""
        with self.evaluation():
            self.work.evaluate(self)

    @contextlib.contextmanager
    def evaluation(self) -> Iterator[None]:
        """What the work does meanwhile does not count as learning."""
        clocks = Clocks()
        yield
        wall, cpu = clocks.passed()
        self.timing.eval_s += wall
        self._clocks.leave_out(wall, cpu)

    def summary(self) -> dict[str, Any]:
        """The content of ``summary.json``."""
        made_by = {"versions": versions(), "command": command_line()}
        return {**self.timing.as_json(), **self.work.summary(), **made_by}


class Clocks:
    """Wall and CPU seconds since now."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.monotonic(), time.process_time()

    def passed(self) -> tuple[float, float]:
        """Seconds on the wall, and of CPU."""
        return time.monotonic() - self._wall, time.process_time() - self._cpu

    def leave_out(self, wall: float, cpu: float) -> None:
        """Do not count these."""
        self._wall, self._cpu = self._wall + wall, self._cpu + cpu
