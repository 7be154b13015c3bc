"""``edtorch-eval``: fresh episodes with the policies of a finished run."""

from __future__ import annotations

import sys
import time
from importlib.resources import files
from pathlib import Path
from typing import cast

import hydra
import torch
from omegaconf import DictConfig, OmegaConf
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from edtorch.app import schemas
from edtorch.app.build import build_policy, build_sim, policy_card
from edtorch.app.checks import at_least, check_keys, check_numbers, check_seeds
from edtorch.app.errors import ConfigError, guarded, no_such_folder, refusing, unknown_key
from edtorch.app.rundir import CONFIG, POLICY, command_line, json_text, load_config, versions
from edtorch.app.signals import Stop
from edtorch.checkpoint import FileProblem, load_policy, policy_dtype, write_text
from edtorch.evaluation import evaluate
from edtorch.records import Episode
from edtorch.report.statistics import evaluation_figures
from edtorch.world import World


def _domain(folder: Path, run_config: DictConfig, changes: DictConfig) -> DictConfig:
    """The run's domain with the changes asked for; unknown keys are refused."""
    domain = run_config.domain
    if not isinstance(domain, DictConfig):
        raise FileProblem(f"{folder / CONFIG}: domain={domain}: expected a mapping with a _target_")
    known = sorted(str(key) for key in domain if key != "_target_")
    for key, value in changes.items():
        if key not in domain:
            raise ConfigError(unknown_key(f"domain.{key}={value}", f"domain.{key}", known))
    merged = OmegaConf.merge(domain, changes)
    return cast(DictConfig, merged)


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


def _task(config: DictConfig) -> float:
    with Stop().listening(), refusing(config.debug):
        return _evaluate(config)


def _evaluate(config: DictConfig) -> float:
    check_keys(config)
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
    sim = build_sim(_domain(folder, run_config, config.domain))
    dtype = policy_dtype(path)
    world = World(sim, dtype)
    policy = build_policy(run_config.policy, sim, dtype, run_config.seed)
    seeds = [run_config.seed + k for k in range(run_config.seeds)]
    shapes = {name: tuple(p.shape) for name, p in policy.named_parameters()}
    parameters = load_policy(path, policy_card(sim, policy, seeds), shapes)

    began = time.monotonic()
    episodes = evaluate(policy, parameters, world, seeds, config.episodes)
    result = {
        "run": str(folder),
        "policy": str(path),
        "episodes": config.episodes,
        "domain": OmegaConf.to_container(config.domain),
        "seeds": seeds,
        **evaluation_figures(episodes),
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
    console.print(_table(episodes, seeds))
    console.print(f"written to {written}", soft_wrap=True)
    return float(result["goal_rate"]["median"])


def main() -> None:
    """Entry point of ``edtorch-eval``."""
    schemas.register_evaluation()
    folder = str(files("conf") / "evaluate")
    run = hydra.main(version_base="1.3", config_path=folder, config_name="evaluate")(_task)
    sys.exit(guarded("edtorch-eval", run))


if __name__ == "__main__":
    main()
