"""The loop of a search between trials: act for a trial, learn a model, find a better policy."""

from __future__ import annotations

import dataclasses
import logging
import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table

from edtorch.app.build_planned import PlannedSetup
from edtorch.app.domain import described
from edtorch.app.errors import ConfigError
from edtorch.app.job import Job, Work
from edtorch.app.pictures import draw_policy, draw_search
from edtorch.app.planned_progress import SeedProgress
from edtorch.app.planned_report import (
    TRIAL_COLUMNS,
    TrialOutcome,
    solved_figures,
    solved_words,
    trial_entry,
)
from edtorch.app.summary import result_figures, summary_table
from edtorch.errors import Contradicted, FitError, NonFiniteError, NoPlan
from edtorch.native.evaluation import evaluate_policies
from edtorch.report.statistics import by_row
from edtorch.run.episodes import Episode, episodes_of, episodes_state, nested_of, nested_state
from edtorch.run.evaluation import Frozen
from edtorch.run.milestones import first_success
from edtorch.run.random import Purpose
from edtorch.run.tick import Source
from edtorch.run.trial import Trial, run_trials
from edtorch.search.problem import Improvement
from edtorch.types import Parameters

logger = logging.getLogger("edtorch")

DOUBTED = 0.5
"""By how much the rate of success in imagination may exceed that in fresh episodes unsaid."""


class PlannedLearners(Work):
    """A search for each seed; its trials run side by side, its plans are made by threads."""

    def __init__(self, setup: PlannedSetup) -> None:
        self._setup = setup
        self._world = setup.world
        self._progress = [SeedProgress() for _ in setup.seeds]
        self._episodes: list[Episode] = []
        self._fresh: list[list[Episode]] = []
        actor, memory = setup.search.actor(setup.problem)
        self.actor, self.observer = actor, memory
        self._parameters: Parameters = setup.initial
        self.domain = described(setup.world)
        spec = setup.world.spec
        self.title = f"{spec.name}, {setup.name}, {len(setup.seeds)} seeds"
        self.notes = [
            f"{self.title}; trials of {setup.length(setup.search.random_trials):g} s, at most"
            f" {setup.budget.in_words('successes')}; told: {setup.told}",
        ]
        self.seeds, self.budget, self.world = setup.seeds, setup.budget, setup.calm
        self.card = setup.card
        self.columns = (*TRIAL_COLUMNS, *setup.search.figures)
        self.measures = [m.name for m in self.domain.measures]
        self.computed = "compiled plans"

    @property
    def seconds(self) -> float:
        """See ``Work``."""
        return max(each.seconds for each in self._progress)

    @property
    def ticks(self) -> int:
        """See ``Work``."""
        return round(sum(each.seconds for each in self._progress) / self._world.dt)

    @property
    def parameters(self) -> Parameters:
        """See ``Work``."""
        return self._parameters

    @property
    def episodes(self) -> Sequence[Episode]:
        """See ``Work``."""
        return self._episodes

    @property
    def holds_state(self) -> bool:
        """See ``Work``."""
        return True

    def state(self) -> dict[str, Any]:
        """See ``Work``; whole between trials."""
        return {
            "seeds": [each.state() for each in self._progress],
            "episodes": episodes_state(self._episodes),
            "parameters": dict(self._parameters),
            "fresh": nested_state(self._fresh),
        }

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``."""
        self._progress = [SeedProgress.of_state(each) for each in state["seeds"]]
        self._episodes = list(episodes_of(state["episodes"]))
        self._parameters = dict(state["parameters"])
        self._fresh = nested_of(state["fresh"])

    def run(self, job: Job) -> None:
        """Trials until every seed has solved its task or has used up its budget."""
        while rows := self._acting():
            began = time.process_time()
            number = self._progress[rows[0]].trials
            trials = self._trials(rows, number)
            figures = self._improved(rows, trials, number)
            outcomes = self._judged(rows, trials, figures, job)
            names, cpu_s = self._setup.search.figures, time.process_time() - began
            about = self._progress, self.seeds, names, self._episodes
            job.take(trial_entry(number, outcomes, *about, cpu_s))
            job.whole()
        self._say_what_is_left()

    def _say_what_is_left(self) -> None:
        """Log why seeds whose task is not solved end before their budget does."""
        setup, limit = self._setup, self._setup.budget.seconds
        early = [
            each
            for each in self._progress
            if each.solved is None and not setup.fits(each.trials, each.seconds)
        ]
        if limit is None or not early:
            return
        most = max(limit - each.seconds for each in early)
        if most > self._world.dt:
            logger.info(
                "%d of %d seeds end with up to %.3g of train.seconds=%g left: another trial may"
                " take %g s",
                *(len(early), len(self.seeds), most, limit, setup.longest(early[0].trials)),
            )

    def _acting(self) -> list[int]:
        """Rows that still run trials; all of these have had the same number."""
        setup = self._setup
        return [
            row
            for row, each in enumerate(self._progress)
            if each.solved is None
            and (setup.trials is None or each.trials < setup.trials)
            and setup.fits(each.trials, each.seconds)
        ]

    def _trials(self, rows: list[int], number: int) -> list[list[Trial]]:
        """The runs of the trial of each row, without those that the simulator lost."""
        setup, world = self._setup, self._world
        ticks, runs = round(setup.length(number) / world.dt), setup.search.runs(number)
        found: dict[int, list[Trial]] = {}
        # A row without a plan acts at random: all of them in the first trials.
        first = number < setup.search.random_trials
        for planned in (False, True):
            group = [row for row in rows if (self._progress[row].planned and not first) == planned]
            if not group:
                continue
            seeds = [setup.seeds[row] for row in group]
            left = None
            if planned:
                own = {name: p[group] for name, p in self._parameters.items()}
                own = {name: p.repeat_interleave(runs, dim=0) for name, p in own.items()}
                source: Source[Any] = Frozen(self.actor, own, self.observer)
                left = setup.search.left(setup.problem, own)
            else:
                source = setup.search.explored(setup.problem, seeds, number)
            trials = run_trials(source, world, seeds, number, ticks, left, runs)
            for place, row in enumerate(group):
                own_runs = trials[place * runs : (place + 1) * runs]
                found[row] = [trial for trial in own_runs if trial is not None]
        return [found[row] for row in rows]

    def _improved(
        self, rows: list[int], trials: list[list[Trial]], number: int
    ) -> list[Mapping[str, float]]:
        """Learn from the trials; the figures of each."""
        with ThreadPoolExecutor(self._setup.threads) as pool:
            results = list(pool.map(self._improvement, rows, trials, [number] * len(rows)))
        figures: list[Mapping[str, float]] = []
        for row, trial, result in zip(rows, trials, results, strict=True):
            progress, seed = self._progress[row], self.seeds[row]
            progress.trials += 1
            if result is None:
                logger.warning("seed %d: trial %d was lost", seed, number)
                figures.append({})
                continue
            found, cpu_s = result
            for name, value in found.parameters.items():
                self._parameters[name] = self._parameters[name].clone()
                self._parameters[name][row] = value
            seconds = 0.0
            for run in trial:
                start = progress.seconds + seconds
                episode = dataclasses.replace(run.episode, row=row, number=number, start=start)
                self._episodes.append(episode)
                seconds += episode.seconds
            progress.learned(found, cpu_s, seconds)
            for note in found.notes:
                logger.info("seed %d, after trial %d: %s", seed, number + 1, note)
            figures.append(found.figures)
        return figures

    def _improvement(
        self, row: int, trial: list[Trial], number: int
    ) -> tuple[Improvement, float] | None:
        """What a seed learns from a trial, and the CPU seconds of that; None where it was lost."""
        if not trial:
            return None
        setup, began = self._setup, time.thread_time()
        knowledge = self._progress[row].knowledge
        for run in trial:
            knowledge = knowledge.with_trial(run.readings, run.actions, run.valid)
        try:
            found = setup.search.improve(setup.problem, knowledge, setup.seeds[row], number + 1)
        except Contradicted as error:
            raise ConfigError(str(error)) from error
        except (FitError, NonFiniteError, NoPlan) as error:
            # The trial is kept, and so is the policy of before.
            found = Improvement({}, knowledge, {}, (f"no better policy: {error}",))
        return found, time.thread_time() - began

    def _judged(
        self,
        rows: list[int],
        trials: list[list[Trial]],
        figures: list[Mapping[str, float]],
        job: Job,
    ) -> list[TrialOutcome]:
        """With the present policies in fresh episodes, which cost no experience and do not count as
        learning."""
        solved = self._setup.solved
        with job.evaluation():
            own = {name: p[rows] for name, p in self._parameters.items()}
            seeds = [self.seeds[row] for row in rows]
            fresh = self._evaluated(own, seeds, solved.episodes, Purpose.SOLVED)
        known = [e.success is not None for episodes in fresh for e in episodes]
        if solved.rate is not None and known and not any(known):
            logger.warning(
                "eval.solved.rate=%s: nothing says whether a fresh episode succeeds; expected a"
                " simulator with Outcome.SUCCEEDED or succeeded(), or eval.success_return",
                solved.rate,
            )
        found = []
        for row, trial, about, episodes in zip(rows, trials, figures, fresh, strict=True):
            whole = bool(trial) and all(run.whole for run in trial)
            outcome = TrialOutcome.of(row, whole, episodes, about)
            rate, mean_return = outcome.success_rate, outcome.mean_return
            imagined = about.get("imagined", math.nan)
            if imagined - rate > DOUBTED:
                logger.info(
                    "seed %d: imagination accepts what reality does not: of imagined trials %.2f"
                    " succeeded, of fresh episodes %.2f",
                    *(self.seeds[row], imagined, rate),
                )
            self._progress[row].judged(rate, solved.holds(rate, mean_return))
            found.append(outcome)
        return found

    def _evaluated(
        self, parameters: Parameters, seeds: Sequence[int], count: int, purpose: Purpose
    ) -> list[list[Episode]]:
        return evaluate_policies(
            self.actor,
            parameters,
            self._setup.calm(),
            seeds,
            count,
            native=self._setup.native,
            observer=self.observer,
            among=self._episodes,
            purpose=purpose,
        )

    def evaluate(self, job: Job) -> None:
        """Fresh episodes of each policy, disjoint from those that decide whether a task is
        solved."""
        count = self._setup.episodes
        if count:
            self._fresh = self._evaluated(self._parameters, self.seeds, count, Purpose.EVALUATION)

    def draw(self, folder: Path, *, animate: bool) -> Figure:
        """``learning_curve.png``: success against experience; an animation of the first policy
        that has solved its task, in a fresh episode."""
        found = [each.experience for each in self._progress]
        figure = draw_search(found, self._setup.solved.rate, self._world.spec.name, folder)
        first = min(range(len(found)), key=lambda row: found[row].solved)
        if animate and self._progress[first].trials:
            own = {name: p[first : first + 1] for name, p in self._parameters.items()}
            seeds = self.seeds[first : first + 1]
            draw_policy(
                *(self.actor, own, self._setup.calm(), seeds, self.domain, folder),
                *(self.observer, self._setup.native),
            )
        return figure

    def summary(self) -> dict[str, Any]:
        """With what it took to solve the task."""
        own = by_row(self._episodes, len(self.seeds))
        first = [
            first_success(episodes, each.seconds)
            for episodes, each in zip(own, self._progress, strict=True)
        ]
        return {
            **result_figures(self.domain, self.seeds, self._fresh, own, first),
            "search": self._setup.name,
            "told": self._setup.told,
            **solved_figures(self._progress, self.seeds),
        }

    def told(self, summary: dict[str, Any]) -> Sequence[Table | str]:
        """Figures over the seeds, and how many have solved the task."""
        table = summary_table(summary, self.domain, self.title)
        return [table, solved_words(summary)] if self._setup.solved.asked else [table]
