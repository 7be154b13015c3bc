"""What a run has learned, for Python: policies, figures, episodes."""

from __future__ import annotations

import json
import math
import shutil
import statistics
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edtorch.app.acting import LearnedPolicy
from edtorch.app.best import score
from edtorch.app.domain import described, measured
from edtorch.learner.learner import Actor
from edtorch.native.evaluation import Mode, evaluate_policies
from edtorch.policy.memory import EpisodeMemory
from edtorch.report.statistics import by_row
from edtorch.run.episodes import Episode
from edtorch.run.log import read_episodes
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.scaled_sim import World
from edtorch.run.success import settled
from edtorch.types import Parameters
from sims.base import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JUDGED = 20
"""Episodes by which ``Run.policy`` is chosen."""


class Run:
    """A run of S learners, one for each of ``seeds``.

    parameters: of their policies, ``[S, ...]``; world: makes a fresh world to evaluate in; records:
    the episodes of learning; summary: the content of ``summary.json``; write: saves a complete run
    folder under a path that does not exist yet; interrupted: whether it was stopped by Ctrl-C
    before the end of its budget; native: whether evaluations use kernels; go_on: continues it in
    a folder, with changed settings and perhaps with reports on the way.

    folder: where it is saved, None: nowhere yet.
    """

    def __init__(
        self,
        *,
        seeds: Sequence[int],
        actor: Actor,
        parameters: Parameters,
        observer: EpisodeMemory | None,
        world: Callable[[], World],
        records: Sequence[Episode],
        summary: dict[str, Any],
        write: Callable[[Path], None],
        interrupted: bool = False,
        native: Mode = "auto",
        go_on: Callable[[Path, Mapping[str, Any], bool], Run],
    ) -> None:
        self.folder: Path | None = None
        self.seeds = list(seeds)
        self.summary = summary
        self.interrupted = interrupted
        self._native: Mode = native
        self._actor = actor
        self._parameters = parameters
        self._observer = observer
        self._world = world
        self._records = list(records)
        self._write = write
        self._go_on = go_on

    def __repr__(self) -> str:
        return f"<edtorch run: {len(self.seeds)} seeds, {len(self._records)} episodes>"

    @cached_property
    def policies(self) -> list[LearnedPolicy]:
        """The policy of each seed, in the order of ``seeds``."""
        world = self._world()
        return [
            LearnedPolicy(world, self._actor, self._of(row), self._observer)
            for row in range(len(self.seeds))
        ]

    @cached_property
    def policy(self) -> LearnedPolicy:
        """The best of ``policies``, by success, then failures, then return in episodes that count
        for nothing else."""
        if not self.seeds:
            raise ValueError("policy: the search found none that always succeeds")
        if len(self.seeds) == 1:
            return self.policies[0]
        judged = self._fresh(JUDGED, Purpose.JUDGING)
        scores = [score(own) for own in judged]
        return self.policies[scores.index(max(scores))]

    def evaluate(self, episodes: int = 50) -> dict[str, list[float | None]]:
        """Run fresh episodes of each policy, without exploration or learning.

        Returns figures with one number per seed: ``return``, ``episode_seconds`` and the sim's own
        measures as means over the episodes, ``success_rate`` and ``failure_rate``; None where there
        is none.  The same episodes again at every call, and the first of more are those of fewer.
        """
        if not isinstance(episodes, Integral) or episodes < 1:
            raise ValueError(f"episodes={episodes}: expected an integer >= 1")
        fresh, spec = self._fresh(episodes, Purpose.EVALUATION), self._world().spec
        seen = [*self._records, *(e for own in fresh for e in own)]
        told = any(e.outcome is Outcome.FAILED or e.success is not None for e in seen)
        return figures(fresh, can_fail=bool(spec.survival or spec.can_fail) or told)

    def env_seeds(self, episodes: int) -> list[list[int]]:
        """For a Gymnasium environment, the seeds that ``evaluate`` resets it with, by learner: with
        them a loop of your own over ``predict`` gives the same episodes, to rounding."""
        world = self._world()
        seed_of = getattr(world.sim, "env_seed", None)
        if seed_of is None:
            raise ValueError(f"env_seeds: expected a Gymnasium environment, not {world.spec.name}")
        keys = [stream_key(s, Purpose.EVALUATION, e) for s in self.seeds for e in range(episodes)]
        drawn = Streams(keys, world.uniforms, 0, world.dtype).at(0).uniform[:, -1].tolist()
        rows = range(0, len(keys), episodes)
        return [[seed_of(uniform) for uniform in drawn[k : k + episodes]] for k in rows]

    @property
    def episodes(self) -> list[dict[str, Any]]:
        """The episodes of learning: seed, episode, start_s, seconds, outcome, return and success
        (None where there is none), and the sim's own measures."""
        return [
            {
                "seed": self.seeds[e.row],
                "episode": e.number,
                "start_s": e.start,
                "seconds": e.seconds,
                "outcome": e.outcome.name.lower(),
                "return": None if math.isnan(e.total_reward) else e.total_reward,
                "success": e.success,
                **{name: value for name, value in e.measures.items() if name != "return"},
            }
            for e in self._records
        ]

    def plot(self) -> Figure:
        """The learning curve: the return of each episode of each seed, or how long it lasted where
        that is what the domain measures, and how it ended."""
        from edtorch.report.figures import height, learning_curve, shortest_time

        size = len(self.seeds)
        world = self._world()
        domain = described(world, measured([self._records]))
        shown = height(domain, shortest_time(self._records, world.spec.shortest), self._records)
        title = f"{domain.name}: {size} learner{'s' if size > 1 else ''}"
        return learning_curve(self._records, size, domain, shown, None, title)

    def save(self, folder: str | Path) -> Path:
        """Write a complete run folder, for ``edtorch.load``, ``edtorch-eval`` and
        ``edtorch-report``.  Raises ValueError if the folder holds something already."""
        path = new_folder(Path(folder))
        self._write(path)
        self.folder = path
        return path

    def resume(self, *, seconds: float | None = None, progress: bool = True) -> Run:
        """Go on with a saved run in its folder, to the end of its budget: what it would have become
        without a break, digit for digit.

        seconds: a larger budget, simulated, of each learner.  A run that is complete stays as it is
        without one.  Raises ValueError, of one line, for a run that was not saved, and where its
        folder does not hold what is needed.
        """
        if self.folder is None:
            raise ValueError("resume: expected a run in a folder; save it first, run.save(FOLDER)")
        changes = {} if seconds is None else {"train.seconds": float(seconds)}
        return self._go_on(self.folder, changes, progress)

    def _fresh(self, episodes: int, purpose: Purpose) -> list[list[Episode]]:
        return evaluate_policies(
            self._actor,
            self._parameters,
            self._world(),
            self.seeds,
            episodes,
            native=self._native,
            observer=self._observer,
            among=self._records,
            purpose=purpose,
        )

    def _of(self, row: int) -> Parameters:
        return {name: p[row : row + 1] for name, p in self._parameters.items()}


def new_folder(path: Path) -> Path:
    """Make it, unless there is an empty one.  Raises ValueError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if not any(path.iterdir()):
            return path
    except OSError as error:
        why = f"a folder to write to ({error.strerror})"
        raise ValueError(f"folder={path}: expected {why}") from error
    raise ValueError(f"folder={path}: expected a new or empty folder")


def figures(
    evaluated: Sequence[Sequence[Episode]], *, can_fail: bool
) -> dict[str, list[float | None]]:
    """See ``Run.evaluate``; can_fail: whether an episode can fail, as far as is known."""
    names = dict.fromkeys(n for own in evaluated for e in own for n in e.measures)
    names.pop("return", None)
    return {
        "return": [_mean([e.total_reward for e in own]) for own in evaluated],
        "success_rate": [_mean([_known(e.success) for e in own]) for own in evaluated],
        "failure_rate": [
            _mean([float(e.outcome is Outcome.FAILED) for e in own]) if can_fail else None
            for own in evaluated
        ],
        "episode_seconds": [_mean([e.seconds for e in own]) for own in evaluated],
        **{name: [_mean([e.measures[name] for e in own]) for own in evaluated] for name in names},
    }


def _known(success: bool | None) -> float:
    return math.nan if success is None else float(success)


def _mean(values: Sequence[float]) -> float | None:
    finite = [v for v in values if math.isfinite(v)]
    return statistics.fmean(finite) if finite else None


def read_records(path: Path, seeds: Sequence[int]) -> list[Episode]:
    """The episodes in an ``episodes.csv``, none without that file; a success that was open when a
    row was written is settled, but for files without that column.  Raises FileProblem."""
    if not path.exists():
        return []
    found = read_episodes(path, seeds)
    with path.open(encoding="utf-8") as file:
        has_success = "success" in file.readline()
    return settled(found, found) if has_success else found


def read_summary(path: Path) -> dict[str, Any]:
    """A ``summary.json``; empty for a run that was interrupted before its evaluation."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def copied(source: Path) -> Callable[[Path], None]:
    """``write`` of a run that was loaded from ``source``."""
    return lambda folder: (shutil.copytree(source, folder, dirs_exist_ok=True), None)[1]


__all__ = ["Run", "by_row", "copied", "figures", "read_records", "read_summary"]
