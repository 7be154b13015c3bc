"""A rival's job behind ``edtorch-train``: search, evaluate policies on the way, leave a run folder.

One search per seed and a summary like a learner's; random search, which counts policies, has a job
of its own (``edtorch.app.random_search``).
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from edtorch.app.budget import build_budget
from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compute import check_choices
from edtorch.app.construct import construct
from edtorch.app.domain import build_sim, changed_domain, described, measured
from edtorch.app.errors import ConfigError, under
from edtorch.app.inverse import has_inverse
from edtorch.app.limit import variant
from edtorch.app.policy import build_linear_policy
from edtorch.app.reward import build_plain_reward
from edtorch.app.rundir import POLICY, SUMMARY, command_line, json_text, versions
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.summary import result_figures, summary_table
from edtorch.app.trials import Paid, Trials
from edtorch.policy.policies import LinearPolicy
from edtorch.report.domain import Domain
from edtorch.report.milestones import checkpoint_figures, milestone_figures
from edtorch.report.statistics import Spread, aliases
from edtorch.rivals.base import Problem, Rival, Search, Storing
from edtorch.rivals.ledger import FirstGoal
from edtorch.rivals.runs import SLOTS, Runs, can_try, evaluator, fresh_episodes
from edtorch.run.checkpoint import PolicyCard, save_policy, write_text
from edtorch.run.episodes import Budget, Episode
from edtorch.run.evaluation import evaluate
from edtorch.run.log import median, summary_writer
from edtorch.run.milestones import MILESTONES, Checkpoint, FirstSuccess
from edtorch.run.scaled_sim import World
from sims.base import Spec, Words

SECONDS_BETWEEN_LINES = 10.0


@dataclass(frozen=True)
class RivalSetup:
    """Everything that a rival's run is made of; calm: a world to try policies in; until: the
    milestone at which a seed is done, None: none."""

    name: str
    rival: Rival
    problem: Problem
    calm: World
    budget: Budget
    until: str | None
    episodes: int

    @property
    def seeds(self) -> list[int]:
        """One search each."""
        return list(self.problem.seeds)


def rival_dtype(compute: Any) -> torch.dtype:
    """Of its world."""
    return torch.float32 if compute.precision == "mixed" else torch.float64


def build_rival(config: Settings) -> RivalSetup:
    """Objects for a rival with a search per seed.  Raises ConfigError, which names the key."""
    check_numbers(config)
    check_seeds(config)
    at_least("compute.threads", config.compute.threads, 1)
    at_least("eval.episodes", config.eval.episodes, 1)
    check_choices(config.compute)
    _refuse_parts_of_learners(config)
    until = config.train.until
    if until is not None and until not in MILESTONES:
        raise ConfigError(f"train.until={until}: expected null or one of {', '.join(MILESTONES)}")
    budget = build_budget(config.train)
    dtype = rival_dtype(config.compute)
    sim = build_sim(config.domain)
    evaluated = build_sim(changed_domain(config.domain, config.eval.domain, "eval.domain"))
    reward, threshold = build_plain_reward(config.reward, sim, dtype), config.eval.success_return
    with under("observation"):
        world, calm = (
            World(s, dtype, None, config.observation.unwrap, reward, threshold)
            for s in (sim, evaluated)
        )
    problem = Problem(
        world=world,
        policy=build_linear_policy(config.policy, sim, dtype, config.seed),
        reward=reward,
        seeds=range(config.seed, config.seed + config.seeds),
        compile=config.compute.compile,
    )
    rival = construct("rival", config.rival, "begin")
    name = str(config.rival._target_).rsplit(".", 1)[-1]
    return RivalSetup(name, rival, problem, calm, budget, until, config.eval.episodes)


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


class _Report:
    """Checkpoints to ``metrics.csv``, TensorBoard and the console; it also looks for a stop."""

    def __init__(
        self,
        setup: RivalSetup,
        domain: Domain,
        config: Settings,
        folder: Path,
        stop: Stop,
        console: Console,
    ) -> None:
        self._seeds = setup.seeds
        self._words = words = domain.words
        self._stop = stop
        self._console = console
        self._file = (folder / "metrics.csv").open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file)
        paid = ("simulated_seconds", "episodes", words.failures, words.successes, "cpu_s")
        self._rows.writerow(("seed", *paid, f"{words.failure}_rate", "goal_rate"))
        self._board = summary_writer(folder) if config.log.tensorboard else None
        self._shown = config.log.progress
        self._printed = -math.inf

    def pause(self) -> None:
        """Raises KeyboardInterrupt once somebody has asked to stop."""
        if self._stop.asked:
            raise KeyboardInterrupt

    def write(self, search: Search, fresh: dict[int, Checkpoint], count: int) -> None:
        """The checkpoints of the seeds that went on, the ``count``-th."""
        for row, found in fresh.items():
            successes = search.accounts[row].successes
            cells = (found.seconds, found.episodes, found.failures, successes, found.cpu_s)
            rates = (found.failure_rate, found.goal_rate)
            self._rows.writerow((self._seeds[row], *(f"{v:.9g}" for v in (*cells, *rates))))
        self._file.flush()
        seconds = median([c.seconds for c in fresh.values()])
        failures = median([float(c.failures) for c in fresh.values()])
        named = self._words.failures
        stable = sum(c.stable for c in fresh.values())
        goal = sum(c.to_the_goal for c in fresh.values())
        if self._board is not None:
            for name, value in (("seconds", seconds), (named, failures), ("stable", stable)):
                self._board.add_scalar(f"rival/{name}", value, count)
            self._board.add_scalar("rival/to_the_goal", goal, count)
        if self._shown and time.monotonic() - self._printed >= SECONDS_BETWEEN_LINES:
            self._printed = time.monotonic()
            self._console.print(
                f"{seconds:8.0f} s  {named} {failures:.0f}  stable {stable}/{len(fresh)}"
                f"  to the goal {goal}/{len(fresh)}",
                soft_wrap=True,
                highlight=False,
            )

    def close(self) -> None:
        """Close the files."""
        self._file.close()
        if self._board is not None:
            self._board.close()


class _Fresh:
    """Evaluates the current policies; plain linear ones use the compiled evaluator."""

    def __init__(self, setup: RivalSetup, search: Search, pause: Callable[[], None]) -> None:
        """pause: as of ``Search.advance``."""
        self._setup = setup
        self._search = search
        self._pause = pause
        self._runs: Runs | None = None

    def __call__(self, rows: Sequence[int], count: int) -> list[list[Episode]]:
        """``count`` of each of ``rows``."""
        picked = {k: p[list(rows)] for k, p in self._search.parameters.items()}
        seeds = [self._setup.seeds[row] for row in rows]
        actor, calm = self._search.actor, self._setup.calm
        if not (isinstance(actor, LinearPolicy) and set(picked) == {"weight"} and can_try(calm)):
            return evaluate(actor, picked, calm, seeds, count)
        if self._runs is None:
            slots = min(SLOTS, len(self._setup.seeds) * self._setup.episodes)
            self._runs = evaluator(calm, actor, slots=slots, mode=self._setup.problem.compile)
        return fresh_episodes(self._runs, calm, picked["weight"], seeds, count, self._pause)


def _paid(search: Search, cpu_s: Sequence[float], row: int) -> Paid:
    account = search.accounts[row]
    return Paid(account.seconds, account.episodes, account.failures, cpu_s[row])


def _search(
    setup: RivalSetup, search: Search, trials: Trials, report: _Report, begun_s: float
) -> list[float]:
    """Piece by piece to the end of every budget; CPU seconds that each seed took.

    begun_s: those that all seeds have taken to begin, when a rival may have computed already.
    """
    cpu_s = [begun_s / len(setup.seeds)] * len(setup.seeds)
    count = 0
    while True:
        going = [
            not over and account.within(setup.budget) and not _arrived(setup, own)
            for over, account, own in zip(search.done, search.accounts, trials.history, strict=True)
        ]
        rows = [row for row, on in enumerate(going) if on]
        if not rows:
            return cpu_s
        began = time.process_time()
        search.advance(going, report.pause)
        took = (time.process_time() - began) / len(rows)
        for row in rows:
            cpu_s[row] += took
        count += 1
        with torch.inference_mode():
            report.write(search, trials.run(rows, partial(_paid, search, cpu_s)), count)
        report.pause()


def _arrived(setup: RivalSetup, history: Sequence[Checkpoint]) -> bool:
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


def _summary(
    setup: RivalSetup,
    search: Search,
    trials: Trials,
    cpu_s: Sequence[float],
    wall_s: float,
) -> dict[str, Any]:
    """The content of ``summary.json``: a learner's, with ``milestones`` and ``checkpoints``."""
    fresh = trials.complete()
    domain = described(setup.calm, measured(fresh))
    lived = [account.seconds for account in search.accounts]
    first: list[FirstSuccess] = []
    paid: dict[str, Any] = {}
    if any(lived):
        first = [account.first_success for account in search.accounts]
        failures = Spread([a.failures for a in search.accounts]).as_json()
        paid = {
            "first_goal": _first_goal(search, setup.seeds, domain.words),
            "episodes": Spread([a.episodes for a in search.accounts]).as_json(),
            "failures": failures,
            **aliases({"failures": failures}, domain.words),
        }
    return {
        "rival": setup.name,
        **result_figures(domain, setup.seeds, fresh, [], first),
        "milestones": milestone_figures(trials.history, setup.seeds, domain),
        "checkpoints": checkpoint_figures(trials.history, domain),
        **paid,
        "simulated_seconds": lived,
        "ticks": round(math.fsum(lived) / setup.problem.world.dt),
        "wall_s": wall_s,
        "cpu_s": math.fsum(cpu_s),
        "eval_s": trials.wall_s,
        "versions": versions(),
        "command": command_line(),
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


def run_rival(
    setup: RivalSetup, config: Settings, folder: Path, stop: Stop, console: Console
) -> dict[str, Any]:
    """Search, write everything; returns the content of ``summary.json``."""
    title = f"{setup.problem.world.spec.name}, {setup.name}, {len(setup.seeds)} seeds"
    began_cpu = time.process_time()
    with under("rival"):
        search = setup.rival.begin(setup.problem)
    begun_s = time.process_time() - began_cpu
    domain = described(setup.calm)
    report = _Report(setup, domain, config, folder, stop, console)
    fresh = _Fresh(setup, search, report.pause)
    trials = Trials(len(setup.seeds), setup.episodes, fresh, domain.measures)
    began = time.monotonic()
    try:
        cpu_s = _search(setup, search, trials, report, begun_s)
    finally:
        report.close()
    wall_s = time.monotonic() - began - trials.wall_s
    summary = _summary(setup, search, trials, cpu_s, wall_s)
    policies = search.stored() if isinstance(search, Storing) else search.parameters
    save_policy(folder / POLICY, policies, rival_card(setup, search, setup.problem.world.spec))
    write_text(folder / SUMMARY, json_text(summary))
    console.print(summary_table(summary, domain, title))
    for name, found in summary["milestones"].items():
        reached = len(setup.seeds) - len(found["never"])
        console.print(
            f"{name}: {reached} of {len(setup.seeds)} seeds; paid until then (median)"
            f" {found['seconds']['median']:.1f} s, {found['failures']['median']:.0f}"
            f" {domain.words.failures},"
            f" {found['cpu_s']['median']:.1f} CPU s",
            soft_wrap=True,
        )
    console.print(f"run folder: {folder}", soft_wrap=True)
    return summary
