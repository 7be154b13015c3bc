"""A search between trials: act for a trial, learn a model, find a better policy, again."""

from __future__ import annotations

import dataclasses
import logging
import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from rich.table import Table

from edtorch.app.build_planned import PlannedSetup
from edtorch.app.domain import described
from edtorch.app.job import Job, Work
from edtorch.app.summary import result_figures, summary_table
from edtorch.errors import FitError, NonFiniteError, NoPlan
from edtorch.native.evaluation import evaluate_policies
from edtorch.report.animation import save_animation
from edtorch.report.experience import SeedExperience, experience_curve, median_seconds
from edtorch.report.figures import save_figure
from edtorch.run.episodes import Episode, episodes_of, episodes_state, nested_of, nested_state
from edtorch.run.evaluation import Frozen, evaluate
from edtorch.run.log import Entry, median_known
from edtorch.run.milestones import first_success
from edtorch.run.random import Purpose
from edtorch.run.tick import Source
from edtorch.run.trial import RandomActions, Trial, run_trials
from edtorch.search.knowledge import Knowledge
from edtorch.search.problem import Improvement
from edtorch.types import Parameters
from sims.base import Pictured

logger = logging.getLogger("edtorch")

_COLUMNS = ("trial", "seed", "seconds", "whole", "success_rate", "mean_return", "solved", "cpu_s")


@dataclasses.dataclass
class _Seed:
    """Where the search of one seed stands.

    planned: whether it has a plan; seconds: of experience; trials: done; after each of them
    seconds_after and the rates of success; solved, solved_trials: seconds and trials when its task
    first counted as solved, None for not yet; cpu_s: of learning from each trial.
    """

    knowledge: Knowledge
    planned: bool = False
    seconds: float = 0.0
    trials: int = 0
    solved: float | None = None
    solved_trials: int | None = None
    seconds_after: list[float] = dataclasses.field(default_factory=list)
    rates: list[float] = dataclasses.field(default_factory=list)
    cpu_s: list[float] = dataclasses.field(default_factory=list)


class PlannedLearners(Work):
    """A search for each seed; its trials run side by side, its plans are made by threads."""

    def __init__(self, setup: PlannedSetup) -> None:
        self._setup = setup
        self._world = setup.world
        self._seeds = [_Seed(Knowledge()) for _ in setup.seeds]
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
        self.columns = (*_COLUMNS, *setup.search.figures)
        self.measures = [m.name for m in self.domain.measures]
        self.computed = "compiled plans"

    @property
    def seconds(self) -> float:
        """See ``Work``."""
        return max(seed.seconds for seed in self._seeds)

    @property
    def ticks(self) -> int:
        """See ``Work``."""
        return round(sum(seed.seconds for seed in self._seeds) / self._world.dt)

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
            "seeds": [{**vars(seed), "knowledge": seed.knowledge.state()} for seed in self._seeds],
            "episodes": episodes_state(self._episodes),
            "parameters": dict(self._parameters),
            "fresh": nested_state(self._fresh),
        }

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``."""
        self._seeds = [
            _Seed(**{**seed, "knowledge": Knowledge.of_state(seed["knowledge"])})
            for seed in state["seeds"]
        ]
        self._episodes = list(episodes_of(state["episodes"]))
        self._parameters = dict(state["parameters"])
        self._fresh = nested_of(state["fresh"])

    def run(self, job: Job) -> None:
        """Trials until every seed has solved its task or has used up its budget."""
        while rows := self._acting():
            began = time.process_time()
            number = self._seeds[rows[0]].trials
            trials = self._trials(rows, number)
            entries = self._improved(rows, trials, number)
            rates = self._judged(rows, job)
            self._report(rows, trials, entries, rates, number, began, job)
            job.whole()

    def _acting(self) -> list[int]:
        """Rows that have a trial to run.  All of them have had as many: those that are done
        stop."""
        setup, limit = self._setup, self._setup.budget
        seconds = math.inf if limit.seconds is None else limit.seconds
        return [
            row
            for row, seed in enumerate(self._seeds)
            if seed.solved is None
            and (setup.trials is None or seed.trials < setup.trials)
            and seed.seconds + setup.length(seed.trials) <= seconds + 1e-9
        ]

    def _trials(self, rows: list[int], number: int) -> list[Trial | None]:
        setup, world = self._setup, self._world
        ticks = round(setup.length(number) / world.dt)
        found: dict[int, Trial | None] = {}
        # A row without a plan acts at random: all of them in the first trials.
        first = number < setup.search.random_trials
        for planned in (False, True):
            group = [row for row in rows if (self._seeds[row].planned and not first) == planned]
            if not group:
                continue
            seeds = [setup.seeds[row] for row in group]
            own = {name: p[group] for name, p in self._parameters.items()}
            source: Source[Any] = RandomActions(
                setup.problem.middle, setup.search.random_size * setup.problem.half
            )
            left = None
            if planned:
                source = Frozen(self.actor, own, self.observer)
                left = setup.search.left(setup.problem, own)
            trials = run_trials(source, world, seeds, number, ticks, left)
            found |= zip(group, trials, strict=True)
        return [found[row] for row in rows]

    def _improved(
        self, rows: list[int], trials: list[Trial | None], number: int
    ) -> list[Mapping[str, float]]:
        """Learn from the trials; the figures of each."""
        setup = self._setup

        def improve(place: int) -> Any:
            row, trial = rows[place], trials[place]
            seed = self._seeds[row]
            began = time.thread_time()
            if trial is None:
                logger.warning("seed %d: trial %d was lost", setup.seeds[row], number)
                return None
            seed.knowledge = seed.knowledge.with_trial(trial.readings, trial.actions, trial.valid)
            try:
                found = setup.search.improve(
                    setup.problem, seed.knowledge, setup.seeds[row], number + 1
                )
            except (FitError, NonFiniteError, NoPlan) as error:
                # The trial is kept, and so is the policy of before.
                found = Improvement({}, seed.knowledge, {}, (f"no better policy: {error}",))
            return found, time.thread_time() - began

        with ThreadPoolExecutor(setup.threads) as pool:
            results = list(pool.map(improve, range(len(rows))))
        figures: list[Mapping[str, float]] = []
        for place, (row, result) in enumerate(zip(rows, results, strict=True)):
            seed, trial = self._seeds[row], trials[place]
            seed.trials += 1
            if result is None or trial is None:
                figures.append({})
                continue
            found, cpu_s = result
            seed.cpu_s.append(cpu_s)
            seed.knowledge = found.knowledge
            seed.planned |= bool(found.parameters)
            for name, value in found.parameters.items():
                self._parameters[name] = self._parameters[name].clone()
                self._parameters[name][row] = value
            episode = trial.episode
            self._episodes.append(
                dataclasses.replace(episode, row=row, number=number, start=seed.seconds)
            )
            seed.seconds += episode.seconds
            for note in found.notes:
                logger.info("seed %d, after trial %d: %s", setup.seeds[row], number + 1, note)
            figures.append(found.figures)
        return figures

    def _judged(self, rows: list[int], job: Job) -> list[tuple[float, float]]:
        """Success rate and mean return of the present policies in fresh episodes, which cost no
        experience and do not count as learning."""
        count = self._setup.solved.episodes
        with job.evaluation():
            own = {name: p[rows] for name, p in self._parameters.items()}
            seeds = [self.seeds[row] for row in rows]
            fresh = self._evaluated(own, seeds, count, Purpose.SOLVED)
        found = []
        for row, episodes in zip(rows, fresh, strict=True):
            rate, mean = _rate(episodes), _mean_return(episodes)
            seed = self._seeds[row]
            seed.rates.append(rate)
            seed.seconds_after.append(seed.seconds)
            if self._setup.solved.holds(rate, mean):
                seed.solved, seed.solved_trials = seed.seconds, seed.trials
            found.append((rate, mean))
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

    def _report(
        self,
        rows: list[int],
        trials: list[Trial | None],
        figures: list[Mapping[str, float]],
        rates: list[tuple[float, float]],
        number: int,
        began: float,
        job: Job,
    ) -> None:
        table = []
        for row, trial, own, (rate, mean) in zip(rows, trials, figures, rates, strict=True):
            seed = self._seeds[row]
            whole = trial is not None and trial.whole
            cells = [own.get(name, math.nan) for name in self._setup.search.figures]
            cpu_s = seed.cpu_s[-1] if seed.cpu_s else math.nan
            solved = int(seed.solved is not None)
            about = (number + 1, self.seeds[row], seed.seconds, int(whole))
            table.append((*about, rate, mean, solved, cpu_s, *cells))
        solved = sum(seed.solved is not None for seed in self._seeds)
        median = median_known([rate for rate, _ in rates])
        scalars = {
            "search/solved": float(solved),
            "search/success_rate": median,
            "search/mean_return": median_known([mean for _, mean in rates]),
            **{
                f"search/{name}": median_known([own.get(name, math.nan) for own in figures])
                for name in self._setup.search.figures
            },
        }
        recent = [e for e in self._episodes if e.number == number]
        job.take(
            Entry(
                rows=table,
                scalars=scalars,
                step=number + 1,
                episodes=[(self.seeds[e.row], e) for e in recent],
                news=f"trial {number + 1}, {self.seconds:g} s: solved {solved} of"
                f" {len(self._seeds)}; success of the others {median:.2f} (median),"
                f" {time.process_time() - began:.1f} CPU s",
            )
        )

    def evaluate(self, job: Job) -> None:
        """Fresh episodes of each policy, others than those that decided whether it has solved its
        task."""
        count = self._setup.episodes
        if count:
            self._fresh = self._evaluated(self._parameters, self.seeds, count, Purpose.EVALUATION)

    def draw(self, folder: Path, *, animate: bool) -> Figure:
        """``learning_curve.png``: success against experience; an animation of the first policy
        that has solved its task, in a fresh episode."""
        found = [
            SeedExperience(
                seed.seconds_after, seed.rates, math.inf if seed.solved is None else seed.solved
            )
            for seed in self._seeds
        ]
        size = len(self.seeds)
        title = f"{self._world.spec.name}: {size} seed{'s' if size > 1 else ''}"
        figure = experience_curve(found, self._setup.solved.rate, title)
        save_figure(figure, folder, "learning_curve")
        first = min(range(size), key=lambda row: found[row].solved)
        world = self._setup.calm()
        if animate and isinstance(world.sim, Pictured) and self._seeds[first].trials:
            states: list[torch.Tensor] = []
            evaluate(
                self.actor,
                {name: p[first : first + 1] for name, p in self._parameters.items()},
                world,
                [self.seeds[first]],
                1,
                watch=lambda now: states.append(now[0]),
                observer=self.observer,
            )
            path = folder / f"{self.domain.words.success}.webp"
            save_animation(world.sim, torch.stack(states), path, fps=round(1 / world.dt))
        return figure

    def summary(self) -> dict[str, Any]:
        """With what it took to solve the task, an unsolved seed counting as infinity."""
        seeds = self._seeds
        lived = [seed.seconds for seed in seeds]
        own = [[e for e in self._episodes if e.row == row] for row in range(len(seeds))]
        first = [first_success(each, seconds) for each, seconds in zip(own, lived, strict=True)]
        return {
            **result_figures(self.domain, self.seeds, self._fresh, own, first),
            "search": self._setup.name,
            "told": self._setup.told,
            "seconds_to_solved": _to_solved([seed.solved for seed in seeds]),
            "trials_to_solved": _to_solved([seed.solved_trials for seed in seeds]),
            "never_solved": [
                self.seeds[row] for row, seed in enumerate(seeds) if seed.solved is None
            ],
            "success_rate_after_trial": [[_shown(rate) for rate in seed.rates] for seed in seeds],
            "seconds_after_trial": [seed.seconds_after for seed in seeds],
            "cpu_s_of_trial": [seed.cpu_s for seed in seeds],
            "simulated_seconds": lived,
        }

    def told(self, summary: dict[str, Any]) -> Sequence[Table | str]:
        """Figures over the seeds, and how many have solved the task."""
        never, spread = summary["never_solved"], summary["seconds_to_solved"]
        size = len(self.seeds)
        lines: list[Table | str] = [summary_table(summary, self.domain, self.title)]
        if self._setup.solved.asked:
            middle = "never" if spread["median"] is None else f"{spread['median']:g} s"
            lines.append(f"solved: {size - len(never)} of {size} seeds; median {middle}")
        return lines


def _to_solved(values: Sequence[float | None]) -> dict[str, Any]:
    """Median and extremes with unsolved seeds as infinity, which is null."""
    numbers = [math.inf if value is None else float(value) for value in values]
    return {
        "per_seed": [_shown(value) for value in numbers],
        "median": _shown(median_seconds(numbers)),
        "min": _shown(min(numbers)),
        "max": _shown(max(numbers)),
    }


def _shown(value: float) -> float | None:
    """In a file: null for what is not finite, or not known as no episode counts as a success."""
    return value if math.isfinite(value) else None


def _rate(episodes: Sequence[Episode]) -> float:
    known = [e.success for e in episodes if e.success is not None]
    return sum(known) / len(known) if known else math.nan


def _mean_return(episodes: Sequence[Episode]) -> float:
    values = [e.total_reward for e in episodes]
    return sum(values) / len(values) if values else math.nan
