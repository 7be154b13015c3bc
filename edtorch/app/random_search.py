"""Random policy search: what it is built from, and what it leaves."""

from __future__ import annotations

import csv
import math
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.table import Table
from torch import Tensor

from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compute import device_of
from edtorch.app.construct import construct, target_class
from edtorch.app.domain import build_sim, described
from edtorch.app.errors import ConfigError, under
from edtorch.app.job import Job, Work
from edtorch.app.policy import build_linear_policy, policy_card
from edtorch.app.settings import Settings
from edtorch.native.choice import Mode
from edtorch.policy.policies import LinearPolicy
from edtorch.report.milestones import milestone_figures
from edtorch.report.proportions import Proportion
from edtorch.report.text import number
from edtorch.rivals.random_search import (
    SECONDS_BETWEEN_REPORTS,
    Progress,
    RandomSearch,
    SearchResult,
    ShardStates,
    policy_weights,
    search,
)
from edtorch.rivals.runs import Runs, check_runnable
from edtorch.run.log import Entry
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters

POLICIES = "policies.csv"


@dataclass(frozen=True)
class SearchSetup:
    """Everything that a random search is made of."""

    settings: RandomSearch
    world: World
    policy: LinearPolicy
    seed: int
    processes: int
    native: Mode


def is_rival(config: Settings) -> bool:
    """Whether something else than the learner is asked for."""
    return config.rival.get("_target_") is not None


def is_search(config: Settings) -> bool:
    """Whether the rival is a random search, which counts policies."""
    return issubclass(target_class("rival", config.rival), RandomSearch)


def build_search(config: Settings) -> SearchSetup:
    """Objects for a random search.  Raises ConfigError, which names the key."""
    check_numbers(config)
    check_seeds(config)
    at_least("compute.threads", config.compute.threads, 1)
    if config.seeds != 1:
        raise ConfigError(
            f"seeds={config.seeds}: expected 1 with rival=random_search; vary seed in a sweep"
        )
    device_of(config.compute)
    settings = construct("rival", config.rival)
    processes = settings.processes
    if processes is None:
        processes = len(os.sched_getaffinity(0))
    at_least("rival.processes", processes, 1)
    sim = build_sim(config.domain)
    policy = build_linear_policy(config.policy, sim, torch.float64, config.seed)
    return SearchSetup(settings, World(sim), policy, config.seed, processes, config.compute.native)


def _numbers(values: Tensor) -> list[float]:
    return [v for v in values.tolist() if math.isfinite(v)]


def search_figures(setup: SearchSetup, result: SearchResult) -> dict[str, Any]:
    """For ``summary.json``.

    median_of_goal_policies: medians over the policies that always reach the goal of what the sim
    measures, a mean over the runs of each.  episodes, steps: of a search that tries one policy
    after the other and drops each at its first failure; steps_done: as made here, with some that
    were not needed.
    milestones: what that search had paid when it had found its first policy that never fails, and
    its first that always reaches the goal, as of a rival with a search per seed; cpu_s there: the
    CPU seconds of this run per step that it made, times the steps until then.
    """
    total = len(result.policy)
    goal, stable = int(result.goal.sum()), int(result.stable.sum())
    seconds = result.steps * setup.world.dt
    figures = {name: _numbers(values) for name, values in result.measures.items()}
    medians = {
        name: float(torch.tensor(values, dtype=torch.float64).median()) if values else None
        for name, values in figures.items()
    }
    running_s = max(result.cpu_s - result.compile_s, 1e-9)
    domain = described(setup.world, result.measures)
    history = result.history(setup.world.dt, running_s / result.steps_done)
    return {
        "seed": setup.seed,
        "features": len(setup.world.spec.state),
        "policies": total,
        "runs": setup.settings.runs,
        "goal": Proportion(goal, total).as_json(),
        "stable_not_to_the_goal": Proportion(stable, total).as_json(),
        "rejected": Proportion(total - goal - stable, total).as_json(),
        "median_of_goal_policies": medians,
        "domain": domain.as_json(),
        "milestones": milestone_figures([history], [setup.seed], domain),
        "episodes": result.episodes,
        "steps": result.steps,
        "simulated_seconds": seconds,
        "simulated_seconds_per_goal_policy": seconds / goal if goal else None,
        "steps_done": result.steps_done,
        "steps_per_cpu_s": result.steps_done / running_s,
        "processes": setup.processes,
        "cpu_s": result.cpu_s,
        "compile_cpu_s": result.compile_s,
    }


def _percent(share: dict[str, Any]) -> tuple[str, str, str]:
    return (
        str(share["count"]),
        f"{100 * share['rate']:.3f} %",
        f"{100 * share['low']:.3f} - {100 * share['high']:.3f} %",
    )


def search_table(summary: dict[str, Any], title: str) -> Table:
    """Counts and shares with their intervals, for the terminal."""
    table = Table(title=title, title_justify="left")
    table.add_column("policies")
    for name in ("count", "share", "Wilson 95 %"):
        table.add_column(name, justify="right")
    runs = summary["runs"]
    table.add_row(f"goal in {runs} of {runs} runs", *_percent(summary["goal"]))
    table.add_row("stable, not always to the goal", *_percent(summary["stable_not_to_the_goal"]))
    table.add_row("failed", *_percent(summary["rejected"]))
    return table


class RandomPolicies(Work):
    """One random search; its policies are those that always arrive, and
    have numbers of their own instead of seeds."""

    COUNTS = ("decided", "goal", "stable", "steps")

    def __init__(self, setup: SearchSetup) -> None:
        with under("rival"):
            check_runnable(setup.world)
            if setup.native == "on":
                Runs(setup.world, setup.policy, native="on")
        self._setup = setup
        self._result: SearchResult | None = None
        self._steps, self._wall_s = 0, 0.0
        self._states: ShardStates | None = None
        self.title = f"{setup.world.spec.name}, {setup.settings.policies} random policies"
        self.seeds, self.actor = [setup.seed], setup.policy
        self.columns = ("wall_s", *self.COUNTS)
        self.world = lambda: setup.world
        self.card = policy_card(setup.world.sim, setup.policy, [])

    @property
    def ticks(self) -> int:
        """See ``Work``."""
        return self._steps

    @property
    def seconds(self) -> float:
        """See ``Work``."""
        return self._steps * self._setup.world.dt

    @property
    def parameters(self) -> Parameters:
        """See ``Work``."""
        setup = self._setup
        numbers = torch.tensor(self.card.seeds, dtype=torch.int64)
        weights = policy_weights(setup.settings, setup.policy, setup.seed, numbers)
        return {"weight": weights.to(setup.world.dtype)}

    @property
    def holds_state(self) -> bool:
        """See ``Work``."""
        return True

    def state(self) -> dict[str, Any] | None:
        """See ``Work``; whole at any time, but of the last whole rounds."""
        return {
            "shards": None if self._states is None else list(self._states),
            "processes": self._setup.processes,
            "steps": self._steps,
            "wall_s": self._wall_s,
        }

    def restore(self, state: Mapping[str, Any], folder: Path) -> None:
        """See ``Work``; in as many processes as before, whatever the machine has now."""
        self._states = state["shards"]
        self._setup = replace(self._setup, processes=state["processes"])
        self._steps, self._wall_s = state["steps"], state["wall_s"]

    def run(self, job: Job) -> None:
        """All policies; an entry twice a second, unless a round is only made again."""
        setup, told = self._setup, time.monotonic()
        began = told - self._wall_s

        def report(progress: Progress, states: ShardStates) -> None:
            nonlocal told
            now = time.monotonic()
            self._states, self._wall_s = states, now - began
            due = progress.decided == setup.settings.policies
            due |= now - told > SECONDS_BETWEEN_REPORTS
            if due and progress.steps > self._steps:
                self._steps, told = progress.steps, now
                job.take(self._entry(progress))
            job.whole()

        self._result = found = search(
            setup.settings,
            setup.world,
            setup.policy,
            seed=setup.seed,
            processes=setup.processes,
            native=setup.native,
            report=report,
            states=self._states,
        )
        numbers = found.policy[found.goal].tolist()
        self.card = policy_card(setup.world.sim, setup.policy, numbers)
        job.keep()

    def _entry(self, progress: Progress) -> Entry:
        wall = self._wall_s
        counts = {name: getattr(progress, name) for name in self.COUNTS}
        return Entry(
            rows=[(f"{wall:.3f}", *counts.values())],
            scalars={f"search/{name}": float(count) for name, count in counts.items()},
            step=round(wall * 10),
            line=f"{wall:5.0f} s  decided {progress.decided}/{self._setup.settings.policies}"
            f"  goal {progress.goal}  stable {progress.stable}"
            f"  {progress.steps / max(wall, 1e-9) / 1e6:.1f} M steps per s",
        )

    def save(self, folder: Path) -> None:
        """``policies.csv``: the policies that never failed."""
        result = self._result
        if result is None:
            return
        kept = (result.goal | result.stable).nonzero().flatten().tolist()
        with (folder / POLICIES).open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(("policy", "kind", *result.measures))
            for row in kept:
                kind = "goal" if bool(result.goal[row]) else "stable"
                cells = (float(values[row]) for values in result.measures.values())
                figures = (f"{v:.6f}" if math.isfinite(v) else "" for v in cells)
                rows.writerow((int(result.policy[row]), kind, *figures))

    def summary(self) -> dict[str, Any]:
        """Nothing of a search that was interrupted."""
        return {} if self._result is None else search_figures(self._setup, self._result)

    def told(self, summary: dict[str, Any]) -> list[Table | str]:
        """Counts and shares, medians, what it took."""
        found: list[Table | str] = [search_table(summary, self.title)]
        for measure in self._setup.world.spec.measures:
            value = summary["median_of_goal_policies"].get(measure.name)
            if value is not None and measure.successes:
                told = f"{measure.with_unit}: {number(value)}"
                found.append(f"{told} (median over the policies to the goal)")
        found.append(
            f"{summary['wall_s']:.1f} s, {summary['steps_per_cpu_s'] / 1e6:.1f} M simulator steps"
            f" per CPU s, {summary['episodes']} episodes"
        )
        return found
