"""A rival's job behind ``edtorch-train``: random policy search, and what it leaves."""

from __future__ import annotations

import csv
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text
from torch import Tensor

from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compute import check_choices
from edtorch.app.construct import construct, target_class
from edtorch.app.domain import build_sim, described
from edtorch.app.errors import ConfigError
from edtorch.app.policy import build_linear_policy, policy_card
from edtorch.app.rundir import POLICY, SUMMARY, command_line, json_text, versions
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.compiled.compilation import CompileMode
from edtorch.policy.policies import LinearPolicy
from edtorch.report.milestones import milestone_figures
from edtorch.report.proportions import Proportion
from edtorch.report.text import number
from edtorch.rivals.random_search import (
    Progress,
    RandomSearch,
    SearchResult,
    policy_weights,
    search,
)
from edtorch.run.checkpoint import save_policy, write_text
from edtorch.run.log import summary_writer
from edtorch.run.scaled_sim import World

POLICIES = "policies.csv"


@dataclass(frozen=True)
class SearchSetup:
    """Everything that a random search is made of."""

    settings: RandomSearch
    world: World
    policy: LinearPolicy
    seed: int
    processes: int
    mode: CompileMode


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
        raise ConfigError(f"seeds={config.seeds}: expected 1 with a rival; vary seed in a sweep")
    check_choices(config.compute)
    settings = construct("rival", config.rival)
    processes = settings.processes
    if processes is None:
        processes = len(os.sched_getaffinity(0))
    at_least("rival.processes", processes, 1)
    dtype = torch.float32 if config.compute.precision == "mixed" else torch.float64
    sim = build_sim(config.domain)
    policy = build_linear_policy(config.policy, sim, dtype, config.seed)
    return SearchSetup(
        settings, World(sim, dtype), policy, config.seed, processes, config.compute.compile
    )


class _Report:
    """Progress to ``metrics.csv``, TensorBoard and the console; it also looks for a stop."""

    COLUMNS = ("wall_s", "decided", "goal", "stable", "steps")

    def __init__(
        self, setup: SearchSetup, config: Settings, folder: Path, stop: Stop, console: Console
    ) -> None:
        self._total = setup.settings.policies
        self._stop = stop
        self._console = console
        self._began = self._printed = time.monotonic()
        self._file = (folder / "metrics.csv").open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._file)
        self._rows.writerow(self.COLUMNS)
        self._board = summary_writer(folder) if config.log.tensorboard else None
        self._live: Live | None = None
        self._shown = config.log.progress
        if self._shown and console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=True)
            self._live.start()

    def __call__(self, progress: Progress) -> None:
        """Raises KeyboardInterrupt once somebody has asked to stop."""
        now = time.monotonic()
        wall = now - self._began
        row = (progress.decided, progress.goal, progress.stable, progress.steps)
        self._rows.writerow((f"{wall:.3f}", *row))
        self._file.flush()
        if self._board is not None:
            for name, value in zip(self.COLUMNS[1:], row, strict=True):
                self._board.add_scalar(f"search/{name}", value, round(wall * 10))
        line = (
            f"{wall:5.0f} s  decided {progress.decided}/{self._total}  goal {progress.goal}  "
            f"stable {progress.stable}  {progress.steps / max(wall, 1e-9) / 1e6:.1f} M steps per s"
        )
        if self._live is not None:
            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"), refresh=True)
        elif self._shown and now - self._printed >= 10:
            self._printed = now
            self._console.print(line, soft_wrap=True, highlight=False)
        if self._stop.asked:
            raise KeyboardInterrupt

    def close(self) -> None:
        """Close the files, leave the terminal as it was."""
        self._file.close()
        if self._board is not None:
            self._board.close()
        if self._live is not None:
            self._live.stop()


def _numbers(values: Tensor) -> list[float]:
    return [v for v in values.tolist() if math.isfinite(v)]


def summarise_search(setup: SearchSetup, result: SearchResult, wall_s: float) -> dict[str, Any]:
    """The content of ``summary.json``.

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
        "wall_s": wall_s,
        "cpu_s": result.cpu_s,
        "compile_cpu_s": result.compile_s,
        "versions": versions(),
        "command": command_line(),
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


def _write_policies(setup: SearchSetup, result: SearchResult, folder: Path) -> None:
    """``policies.csv``: who never failed; ``policy.safetensors``: weights of who always arrived."""
    kept = (result.goal | result.stable).nonzero().flatten().tolist()
    with (folder / POLICIES).open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(("policy", "kind", *result.measures))
        for row in kept:
            kind = "goal" if bool(result.goal[row]) else "stable"
            cells = (float(values[row]) for values in result.measures.values())
            figures = (f"{v:.6f}" if math.isfinite(v) else "" for v in cells)
            rows.writerow((int(result.policy[row]), kind, *figures))
    ids = result.policy[result.goal]
    weights = policy_weights(setup.settings, setup.policy, setup.seed, ids)
    card = policy_card(setup.world.sim, setup.policy, ids.tolist())
    save_policy(folder / POLICY, {"weight": weights.to(setup.world.dtype)}, card)


def run_search(
    setup: SearchSetup, config: Settings, folder: Path, stop: Stop, console: Console
) -> dict[str, Any]:
    """Search, write everything; returns the content of ``summary.json``."""
    title = f"{setup.world.spec.name}, {setup.settings.policies} random policies"
    report = _Report(setup, config, folder, stop, console)
    began = time.monotonic()
    try:
        result = search(
            setup.settings,
            setup.world,
            setup.policy,
            seed=setup.seed,
            processes=setup.processes,
            mode=setup.mode,
            report=report,
        )
    finally:
        report.close()
    summary = summarise_search(setup, result, time.monotonic() - began)
    _write_policies(setup, result, folder)
    write_text(folder / SUMMARY, json_text(summary))
    console.print(search_table(summary, title))
    for measure in setup.world.spec.measures:
        value = summary["median_of_goal_policies"].get(measure.name)
        if value is not None and measure.successes:
            told = f"{measure.with_unit}: {number(value)}"
            console.print(f"{told} (median over the policies to the goal)", highlight=False)
    console.print(
        f"{summary['wall_s']:.1f} s, {summary['steps_per_cpu_s'] / 1e6:.1f} M simulator steps per"
        f" CPU s, {summary['episodes']} episodes",
        soft_wrap=True,
    )
    console.print(f"run folder: {folder}", soft_wrap=True)
    return summary
