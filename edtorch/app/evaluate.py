"""``edtorch-eval``: fresh episodes with the policies of a finished run."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import torch
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compose import CONF, launch, plainly
from edtorch.app.errors import ConfigError, guarded, no_such_folder, refusing
from edtorch.app.groups import Evaluate
from edtorch.app.policies import frozen_world, stored_policies
from edtorch.app.rundir import POLICY, command_line, json_text, load_config, versions
from edtorch.app.schema import checked_fields
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.report.statistics import evaluation_figures, goal_figures
from edtorch.run.checkpoint import write_text
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import evaluate, evaluate_yardstick
from edtorch.run.scaled_sim import World
from sims.base import baselines_of


def _table(episodes: list[list[Episode]], seeds: list[int]) -> Table:
    figures = evaluation_figures(episodes)
    table = Table(
        title="fresh episodes, no exploration", title_justify="left", box=SIMPLE, padding=(0, 1)
    )
    columns = (
        ("seed", None, 0),
        ("goal rate", "goal_rate", 3),
        ("fall rate", "fall_rate", 3),
        ("goal time, s", "goal_time_s", 2),
        ("over shortest", "goal_time_over_shortest", 4),
        ("path, m", "path_length_m", 1),
        ("episode, s", "episode_s", 2),
    )
    for label, _, _ in columns:
        table.add_column(label, justify="right")
    for row, seed in enumerate(seeds):
        cells = [str(seed)]
        for _, key, digits in columns[1:]:
            value = figures[str(key)]["per_seed"][row]
            cells.append("-" if value is None else f"{value:.{digits}f}")
        table.add_row(*cells)
    return table


def _goal_table(figures: dict[str, Any], baselines: dict[str, Any], seeds: list[int]) -> Table:
    """Of a family of tasks: a row per seed and per baseline, a column per figure."""
    table = Table(
        title="fresh episodes, no exploration", title_justify="left", box=SIMPLE, padding=(0, 1)
    )
    for label in ("seed", *(name.replace("_", " ") for name in figures)):
        table.add_column(label, justify="right")
    for row, seed in enumerate(seeds):
        table.add_row(str(seed), *(_cell(spread["per_seed"][row]) for spread in figures.values()))
    for name, own in baselines.items():
        table.add_row(name.replace("_", " "), *(_cell(own[key]["median"]) for key in figures))
    return table


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _baselines(config: Settings, world: World, seeds: list[int]) -> dict[str, Any]:
    """The figures of the sim's own controllers, by name, in the episodes of the first seed."""
    if not (config.baselines or config.yardsticks):
        return {}
    controllers = baselines_of(world.sim)
    if not controllers:
        key = "baselines" if config.baselines else "yardsticks"
        raise ConfigError(
            f"{key}=true: expected a domain with baselines; {world.spec.name} has none"
        )
    return {
        name: goal_figures(evaluate_yardstick(control, world, seeds[:1], config.episodes))
        for name, control in controllers.items()
    }


def _task(composed: Any) -> float:
    with Stop().listening(), refusing():
        return _evaluate(checked_fields(Evaluate, plainly(composed)))


def _evaluate(config: Settings) -> float:
    check_numbers(config)
    at_least("episodes", config.episodes, 1)
    at_least("threads", config.threads, 1)
    torch.set_num_threads(config.threads)
    folder = Path(config.run)
    run_config = load_config(folder)
    check_seeds(run_config)
    path = Path(config.policy) if config.policy is not None else folder / POLICY
    if not path.is_file():
        raise (
            no_such_folder(folder, POLICY)
            if config.policy is None
            else ConfigError(f"policy={path}: no such file")
        )
    world = frozen_world(run_config, path, config.domain)
    stored = stored_policies(run_config, path, world)
    seeds = stored.seeds

    began = time.monotonic()
    baselines = _baselines(config, world, seeds)
    episodes = evaluate(
        stored.actor,
        stored.parameters,
        world,
        seeds,
        config.episodes,
        observer=stored.observer,
    )
    reached = goal_figures(episodes) if world.spec.goal else {}
    result = {
        "run": str(folder),
        "policy": str(path),
        "episodes": config.episodes,
        "domain": config.domain.plain(),
        "seeds": seeds,
        **evaluation_figures(episodes),
        **reached,
        "baselines": baselines,
        "eval_s": time.monotonic() - began,
        "versions": versions(),
        "command": command_line(),
    }
    written = folder / f"eval_{time.strftime('%Y-%m-%d_%H-%M-%S')}.json"
    try:
        write_text(written, json_text(result))
    except OSError as error:
        raise ConfigError(
            f"run={folder}: expected a folder to write to ({error.strerror})"
        ) from error
    console = Console()
    table = _goal_table(reached, baselines, seeds) if reached else _table(episodes, seeds)
    console.print(table)
    console.print(f"written to {written}", soft_wrap=True)
    return float(result["goal_rate"]["median"])


def main() -> None:
    """Entry point of ``edtorch-eval``."""
    sys.exit(guarded("edtorch-eval", lambda: launch(_task, CONF / "evaluate", "evaluate")))


if __name__ == "__main__":
    main()
