"""``edtorch-eval``: fresh episodes with the policies of a finished run."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import torch
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compose import CONF, launch, plainly
from edtorch.app.compute import required
from edtorch.app.domain import described, measured
from edtorch.app.errors import ConfigError, guarded, no_such_folder, refusing
from edtorch.app.groups import Evaluate
from edtorch.app.learned import read_records
from edtorch.app.policies import frozen_world, stored_policies
from edtorch.app.rundir import (
    POLICY,
    as_settings,
    command_line,
    json_text,
    read_config,
    versions,
)
from edtorch.app.schema import checked_fields
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.trust import check_trust, trusted
from edtorch.native.evaluation import Mode, evaluate_policies
from edtorch.report.domain import RETURN, Domain
from edtorch.report.quantities import evaluation, told_of
from edtorch.report.statistics import evaluation_figures
from edtorch.report.text import number
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import evaluate_controller
from edtorch.run.files import write_text
from edtorch.run.scaled_sim import World
from sims.base import baselines_of

HEADLINE = ("success_rate", RETURN, "episode_s")
"""The first that is known is what a sweep over evaluations compares."""


def _table(
    result: dict[str, Any], baselines: dict[str, Any], domain: Domain, seeds: list[int]
) -> Table:
    """A row per seed and per baseline, a column per figure."""
    table = Table(
        title="fresh episodes, no exploration", title_justify="left", box=SIMPLE, padding=(0, 1)
    )
    columns = told_of(domain, result, evaluation(domain))
    for label in ("seed", *(quantity.brief for quantity in columns)):
        table.add_column(label, justify="right")

    def cells(figures: Callable[[str], float | None]) -> list[str]:
        return [number(figures(q.path[0]), q.digits) for q in columns]

    for row, seed in enumerate(seeds):
        table.add_row(str(seed), *cells(lambda key, row=row: result[key]["per_seed"][row]))
    for name, own in baselines.items():
        # One that never succeeds lacks what is known of successes alone.
        found = cells(lambda key, own=own: own.get(key, {}).get("median"))
        table.add_row(name.replace("_", " "), *found)
    return table


def _print_whole(console: Console, table: Table) -> None:
    """Print the table with no word or figure cut: a terminal that is too narrow gets columns as
    wide as their longest words, and if need be lines that are longer than it is wide."""
    unlimited = console.options.update_width(sys.maxsize)
    if console.measure(table, options=unlimited).maximum > console.width:
        for column in table.columns:
            texts = (str(column.header), *map(str, column.cells))
            column.width = max(len(word) for text in texts for word in text.split())
        needed = console.measure(table, options=unlimited).maximum
        console.width = max(console.width, needed)
    console.print(table)


def _baselines(config: Settings, world: World, domain: Domain, seeds: list[int]) -> dict[str, Any]:
    """The figures of the sim's own controllers, by name, in the episodes of the first seed."""
    if not (config.baselines or config.yardsticks):
        return {}
    controllers = baselines_of(world.sim)
    if not controllers:
        key = "baselines" if config.baselines else "yardsticks"
        raise ConfigError(
            f"{key}=true: expected a domain with baselines; {world.spec.name} has none"
        )
    found: dict[str, Any] = {}
    for name, control in controllers.items():
        episodes = evaluate_controller(control, world, seeds[:1], config.episodes)
        found[name] = evaluation_figures(episodes, domain.measures, domain.words)
    return found


def _lived(folder: Path, world: World, seeds: list[int]) -> Sequence[Episode]:
    """The episodes of the run, where they decide what a success is."""
    path = folder / "episodes.csv"
    return read_records(path, seeds) if world.rule.survival is None and path.is_file() else ()


def _task(composed: Any) -> float:
    with Stop().listening(), refusing():
        return _evaluate(checked_fields(Evaluate, plainly(composed)))


def _evaluate(config: Settings) -> float:
    check_numbers(config)
    at_least("episodes", config.episodes, 1)
    at_least("threads", config.threads, 1)
    if config.native not in get_args(Mode):
        raise ConfigError(f"native={config.native}: expected one of {', '.join(get_args(Mode))}")
    torch.set_num_threads(config.threads)
    folder = Path(config.run)
    content = read_config(folder)
    check_trust(
        {**content, "domain": {**content["domain"], **config.domain}}, trusted(config.trust)
    )
    run_config = as_settings(folder, content)
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
    with required("native"):
        episodes = evaluate_policies(
            stored.actor,
            stored.parameters,
            world,
            seeds,
            config.episodes,
            native=config.native,
            observer=stored.observer,
            among=_lived(folder, world, seeds) if config.policy is None else (),
        )
    domain = described(world, measured(episodes))
    baselines = _baselines(config, world, domain, seeds)
    figures = evaluation_figures(episodes, domain.measures, domain.words)
    result = {
        "run": str(folder),
        "policy": str(path),
        "episodes": config.episodes,
        "domain": config.domain.plain(),
        "seeds": seeds,
        **figures,
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
    _print_whole(console, _table(figures, baselines, domain, seeds))
    console.print(f"written to {written}", soft_wrap=True)
    headline = next(figures[key]["median"] for key in HEADLINE if key in figures)
    return math.nan if headline is None else float(headline)


def main() -> None:
    """Entry point of ``edtorch-eval``."""
    sys.exit(guarded("edtorch-eval", lambda: launch(_task, CONF / "evaluate", "evaluate")))


if __name__ == "__main__":
    main()
