"""Rivals with a search per seed, their policies evaluated on the way, a summary like a learner's.

Random search, which counts policies, is in ``edtorch.app.random_search``.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, cast

import torch
from rich.table import Table

from edtorch.app.budget import build_budget, check_ticks
from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compute import device_of
from edtorch.app.construct import construct
from edtorch.app.domain import build_sim, changed_domain, described, measured
from edtorch.app.errors import ConfigError, under
from edtorch.app.inverse import has_inverse
from edtorch.app.job import Job, Work
from edtorch.app.limit import variant
from edtorch.app.policy import build_linear_policy
from edtorch.app.reward import build_plain_reward, build_reward, refuse_timed
from edtorch.app.settings import Settings
from edtorch.app.solved import Solved, build_solved_rate, checkpoint_solved, first_solved
from edtorch.app.summary import result_figures, summary_table
from edtorch.app.trials import SCREENING, Paid, Trials
from edtorch.policy.policies import LinearPolicy
from edtorch.report.milestones import checkpoint_figures, milestone_figures
from edtorch.report.statistics import Spread, aliases
from edtorch.rivals.base import Problem, Resumable, Rival, Search, Storing
from edtorch.rivals.ledger import FirstGoal
from edtorch.rivals.runs import Runs, can_try, evaluator, fresh_episodes
from edtorch.run.episodes import Budget, Episode
from edtorch.run.evaluation import evaluate
from edtorch.run.log import Entry, median_known
from edtorch.run.milestones import MILESTONES, Checkpoint, FirstSuccess
from edtorch.run.policy_file import PolicyCard
from edtorch.run.random import Purpose
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters
from sims.base import Sim, Spec, Words

logger = logging.getLogger("edtorch")


@dataclass(frozen=True)
class RivalSetup:
    """Everything that a rival's run is made of; calm: a new world to try policies in; until: the
    milestone at which a seed is done, None: none; solved: when it is done as well."""

    name: str
    rival: Rival
    problem: Problem
    calm: Callable[[], World]
    budget: Budget
    until: str | None
    solved: Solved
    episodes: int

    @property
    def seeds(self) -> list[int]:
        """One search each."""
        return list(self.problem.seeds)


def build_rival(config: Settings) -> RivalSetup:
    """Objects for a rival with a search per seed.  Raises ConfigError, which names the key."""
    check_numbers(config)
    check_seeds(config)
    at_least("compute.threads", config.compute.threads, 1)
    at_least("eval.episodes", config.eval.episodes, 1)
    device_of(config.compute)
    _refuse_parts_of_learners(config)
    until = config.train.until
    if until is not None and until not in MILESTONES:
        raise ConfigError(f"train.until={until}: expected null or one of {', '.join(MILESTONES)}")
    budget = build_budget(config.train)
    dtype = torch.float64
    sim = build_sim(config.domain)
    check_ticks(budget, sim.spec.dt)
    evaluated = changed_domain(config.domain, config.eval.domain, "eval.domain")
    rival = construct("rival", config.rival, "begin")
    built = build_reward if getattr(rival, "takes_any_reward", False) else build_plain_reward
    reward, threshold = built(config.reward, sim, dtype), config.eval.success_return
    refuse_timed(reward)

    def world_of(sim: Sim) -> World:
        return World(sim, dtype, None, config.observation.unwrap, reward, threshold)

    def calm() -> World:
        return world_of(build_sim(evaluated))

    with under("observation"):
        world, _ = world_of(sim), calm()
    problem = Problem(
        world=world,
        policy=build_linear_policy(config.policy, sim, dtype, config.seed),
        reward=reward,
        seeds=range(config.seed, config.seed + config.seeds),
        native=config.compute.native,
    )
    name = str(config.rival._target_).rsplit(".", 1)[-1]
    solved = build_solved_rate(config)
    return RivalSetup(name, rival, problem, calm, budget, until, solved, config.eval.episodes)


def _refuse_parts_of_learners(config: Settings) -> None:
    """What would change nothing of a rival, and must not seem to."""
    if variant(config.command) != "free":
        raise ConfigError(
            f"command={config.command.variant}: expected free with a rival, which sees all"
        )
    if config.observation.delay or config.observation.noise:
        raise ConfigError(
            f"observation.delay={config.observation.delay}, observation.noise="
            f"{dict(config.observation.noise)}: expected 0 and nothing with a rival, which takes"
            " readings for the state"
        )
    if has_inverse(config):
        raise ConfigError(
            f"inverse={config.inverse.variant}: expected none with a rival, whose policies act"
        )


class _Fresh:
    """Evaluates the current policies; those linear in features by ``fresh_episodes``.

    purpose: of the random numbers elsewhere; other than EVALUATION: always of these.
    """

    def __init__(self, setup: RivalSetup, search: Search, purpose: Purpose) -> None:
        self._setup = setup
        self._purpose = purpose
        self._search = search
        self.pause: Callable[[], None] = lambda: None
        """As of ``Search.advance``."""
        self._runs: Runs | None = None

    def __call__(self, rows: Sequence[int], count: int) -> list[list[Episode]]:
        """``count`` of each of ``rows``."""
        picked = {k: p[list(rows)] for k, p in self._search.parameters.items()}
        seeds = [self._setup.seeds[row] for row in rows]
        actor, calm = self._search.actor, self._setup.calm()
        linear = getattr(actor, "linear_in_features", False)
        linear &= self._purpose is Purpose.EVALUATION
        if not (linear and set(picked) == {"weight"} and can_try(calm)):
            return evaluate(actor, picked, calm, seeds, count, purpose=self._purpose)
        if self._runs is None:
            self._runs = evaluator(
                calm, cast(LinearPolicy, actor), native=self._setup.problem.native
            )
        return fresh_episodes(self._runs, calm, picked["weight"], seeds, count, self.pause)


def _arrived(setup: RivalSetup, history: Sequence[Checkpoint]) -> bool:
    if first_solved(history, setup.solved):
        return True
    if setup.until is None or not history:
        return False
    return bool(getattr(history[-1], MILESTONES[setup.until]))


def _first_goal(search: Search, seeds: Sequence[int], words: Words) -> dict[str, Any]:
    """The first episode of each search to the goal, while it learned; see ``FirstGoal``."""
    goals = [account.goal for account in search.accounts]
    figures = {
        f.name: Spread([None if g is None else getattr(g, f.name) for g in goals]).as_json()
        for f in fields(FirstGoal)
    }
    return {
        **figures,
        **aliases(figures, words),
        "never": [seed for seed, goal in zip(seeds, goals, strict=True) if goal is None],
    }


def rival_card(setup: RivalSetup, search: Search, spec: Spec) -> PolicyCard:
    """What its policies are made for, of a world of this spec."""
    return PolicyCard(
        domain=spec.name,
        states=[q.name for q in spec.state],
        actions=[q.name for q in spec.action],
        scales=[q.scale for q in (*spec.state, *spec.action)],
        policy=f"{setup.name}: {type(search.actor).__name__}",
        seeds=setup.seeds,
    )


class Rivals(Work):
    """A search per seed."""

    def __init__(self, setup: RivalSetup) -> None:
        self._setup = setup
        began = time.process_time()
        with under("rival"):
            self._search = setup.rival.begin(setup.problem)
        # When a rival begins it may have computed already.
        begun_s = time.process_time() - began
        self._cpu_s = [begun_s / len(setup.seeds)] * len(setup.seeds)
        self._pieces = 0
        self._domain = described(setup.calm())
        asked = setup.solved.asked
        # What decides whether a task is solved does not report how well.
        purpose = Purpose.SOLVED if asked else Purpose.EVALUATION
        self._fresh = _Fresh(setup, self._search, purpose)
        self._trials = Trials(
            *(len(setup.seeds), setup.episodes, self._fresh, self._domain.measures),
            screening=setup.episodes if asked else SCREENING,
        )
        self._others: list[list[Episode]] = []
        spec, words = setup.problem.world.spec, self._domain.words
        self.title = f"{spec.name}, {setup.name}, {len(setup.seeds)} seeds"
        self.seeds, self.budget, self.world = setup.seeds, setup.budget, setup.calm
        paid = ("simulated_seconds", "episodes", words.failures, words.successes, "cpu_s")
        self.columns = ("seed", *paid, f"{words.failure}_rate", "goal_rate")
        self.actor, self.card = self._search.actor, rival_card(setup, self._search, spec)

    @property
    def _lived(self) -> list[float]:
        return [account.seconds for account in self._search.accounts]

    @property
    def seconds(self) -> float:
        """See ``Work``."""
        return max(self._lived)

    @property
    def ticks(self) -> int:
        """See ``Work``."""
        return round(math.fsum(self._lived) / self._setup.problem.world.dt)

    @property
    def parameters(self) -> Parameters:
        """See ``Work``."""
        return self._search.parameters

    @property
    def stored(self) -> Parameters:
        """See ``Work``."""
        search = self._search
        return search.stored() if isinstance(search, Storing) else search.parameters

    @property
    def holds_state(self) -> bool:
        """See ``Work``."""
        return isinstance(self._search, Resumable)

    def state(self) -> dict[str, Any] | None:
        """See ``Work``; whole between two pieces.  None for a search that is not ``Resumable``."""
        if not isinstance(self._search, Resumable):
            return None
        return {
            "search": self._search.state(),
            "trials": self._trials.state(),
            "cpu_s": list(self._cpu_s),
            "pieces": self._pieces,
        }

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``."""
        assert isinstance(self._search, Resumable)
        self._search.restore(state["search"])
        self._trials.restore(state["trials"])
        self._cpu_s, self._pieces = list(state["cpu_s"]), state["pieces"]

    def run(self, job: Job) -> None:
        """Piece by piece to the end of every budget, each followed by a trial of the policies."""
        search, trials, setup = self._search, self._trials, self._setup
        self._fresh.pause = job.pause
        while True:
            states = zip(search.done, search.accounts, trials.history, strict=True)
            going = [
                not over and account.within(setup.budget) and not _arrived(setup, own)
                for over, account, own in states
            ]
            rows = [row for row, on in enumerate(going) if on]
            if not rows:
                self._warn_of_excess()
                job.keep()
                return
            began = time.process_time()
            search.advance(going, job.pause)
            took = (time.process_time() - began) / len(rows)
            for row in rows:
                self._cpu_s[row] += took
            self._pieces += 1
            with job.evaluation(), torch.inference_mode():
                fresh = trials.run(rows, self._paid)
            job.take(self._entry(fresh))
            job.whole()

    def _warn_of_excess(self) -> None:
        """A rival's piece, such as all the episodes of a batch method, is not divided."""
        most = self._setup.budget.seconds
        if most is not None and self.seconds > 1.01 * most:
            logger.warning(
                "train.seconds=%g: up to %.6g s were used; the pieces in which %s learns are not"
                " divided",
                *(most, self.seconds, self._setup.name),
            )

    def _paid(self, row: int) -> Paid:
        account = self._search.accounts[row]
        return Paid(account.seconds, account.episodes, account.failures, self._cpu_s[row])

    def _entry(self, fresh: dict[int, Checkpoint]) -> Entry:
        """The checkpoints of the seeds that went on, after the last piece."""
        words, accounts = self._domain.words, self._search.accounts
        seconds = median_known([c.seconds for c in fresh.values()])
        failures = median_known([float(c.failures) for c in fresh.values()])
        stable = sum(c.stable for c in fresh.values())
        goal = sum(c.to_the_goal for c in fresh.values())
        rows = [
            (
                *(self.seeds[row], c.seconds, c.episodes, c.failures, accounts[row].successes),
                *(c.cpu_s, c.failure_rate, c.goal_rate),
            )
            for row, c in fresh.items()
        ]
        figures = {
            "seconds": seconds,
            words.failures: failures,
            "stable": stable,
            "to_the_goal": goal,
        }
        return Entry(
            rows=rows,
            scalars={f"rival/{name}": float(value) for name, value in figures.items()},
            step=self._pieces,
            line=f"{seconds:8.0f} s  {self._counts(fresh, failures, stable, goal)}",
        )

    def _counts(self, fresh: dict[int, Checkpoint], failures: float, stable: int, goal: int) -> str:
        """What applies to the domain, as far as it declares that or has shown it."""
        domain, told = self._domain, []
        if domain.can_fail or failures:
            told += [f"{domain.words.failures} {failures:.0f}", f"stable {stable}/{len(fresh)}"]
        if domain.has_goal:
            told.append(f"to the goal {goal}/{len(fresh)}")
        episodes = median_known([float(c.episodes) for c in fresh.values()])
        return "  ".join(told) or f"episodes {episodes:.0f}"

    def evaluate(self, job: Job) -> None:
        """All fresh episodes of the last policies; others than those that decided whether they
        have solved their task."""
        setup = self._setup
        if setup.solved.asked:
            fresh = _Fresh(setup, self._search, Purpose.EVALUATION)
            fresh.pause = job.pause
            self._others = fresh(range(len(setup.seeds)), setup.episodes)
        else:
            self._trials.complete()

    def summary(self) -> dict[str, Any]:
        """A learner's, with ``milestones`` and ``checkpoints``."""
        fresh, history = self._others or self._trials.last, self._trials.history
        accounts = self._search.accounts
        domain = described(self.world(), measured(fresh))
        first: list[FirstSuccess] = []
        paid: dict[str, Any] = {}
        if any(self._lived):
            first = [account.first_success for account in accounts]
            failures = Spread([a.failures for a in accounts]).as_json()
            paid = {
                "first_goal": _first_goal(self._search, self.seeds, domain.words),
                "episodes": Spread([a.episodes for a in accounts]).as_json(),
                "failures": failures,
                **aliases({"failures": failures}, domain.words),
            }
        if all(history):
            paid["milestones"] = milestone_figures(history, self.seeds, domain)
            paid["checkpoints"] = checkpoint_figures(history, domain)
        return {
            "rival": self._setup.name,
            **result_figures(domain, self.seeds, fresh, [], first),
            **paid,
            **checkpoint_solved(history, self._setup.solved, self.seeds),
            "simulated_seconds": self._lived,
            "cpu_s": math.fsum(self._cpu_s),
        }

    def told(self, summary: dict[str, Any]) -> list[Table | str]:
        """Figures over the seeds, and what was paid before the milestones."""
        found: list[Table | str] = [summary_table(summary, self._domain, self.title)]
        for name, own in summary["milestones"].items():
            reached = len(self.seeds) - len(own["never"])
            found.append(
                f"{name}: {reached} of {len(self.seeds)} seeds; paid until then (median)"
                f" {own['seconds']['median']:.1f} s, {own['failures']['median']:.0f}"
                f" {self._domain.words.failures}, {own['cpu_s']['median']:.1f} CPU s"
            )
        return found
