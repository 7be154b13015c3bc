"""The outcome of a run: ``summary.json``, the table at the end, TensorBoard's table of settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import torch
from rich.table import Table
from torch import Tensor

from edtorch.app.evaluations import Evaluations
from edtorch.app.rundir import command_line, versions
from edtorch.app.settings import Settings
from edtorch.learner.learner import Check
from edtorch.report.statistics import evaluation_figures, learning_figures
from edtorch.run.training import Training
from edtorch.types import LearnerState


@dataclass
class Timing:
    """Seconds that the parts of a run took.

    startup: from the start of the process to the first tick; wall, cpu: of the learning loop,
    logging included; eval, figures: evaluation and pictures.
    """

    startup_s: float = 0.0
    wall_s: float = 0.0
    cpu_s: float = 0.0
    eval_s: float = 0.0
    figures_s: float = 0.0
    ticks: int = 0

    @property
    def ticks_per_cpu_s(self) -> float:
        """Learner ticks of the whole population per CPU second of the loop."""
        return self.ticks / max(self.cpu_s, 1e-9)


class Learned(Protocol):
    """Learners that have learned, however they came by their experience."""

    seeds: list[int]

    @property
    def learners(self) -> LearnerState:
        """What they know."""
        ...

    @property
    def finite(self) -> Tensor:
        """``[3, B]``: see ``edtorch.learner.learner.Check``."""
        ...


def broken(training: Learned) -> dict[int, tuple[str, int]]:
    """Learners whose numbers were not finite somewhere: the first place, the first tick."""
    rows = (~training.finite).any(0).nonzero().flatten().tolist()
    sound_ticks = training.learners.sound_ticks.tolist()
    places = training.finite.to(torch.int8).argmin(0).tolist()
    return {row: (Check(places[row]).name.lower(), sound_ticks[row]) for row in rows}


def summarise(training: Training, timing: Timing, evaluations: Evaluations) -> dict[str, Any]:
    """The content of ``summary.json``, after at least one evaluation in full: that of the end."""
    last, kept = evaluations.done[-1], evaluations.kept
    has_goal = bool(training.world.spec.goal) and any(last.episodes)
    reached = {}
    if has_goal:
        reached = {
            "lost_episodes": sum(e.measures.get("lost", 0.0) > 0 for e in training.episodes),
            "evaluations": [evaluation.as_json() for evaluation in evaluations.done],
            "final": last.as_json(),
        }
    if kept is not None:
        reached["kept"] = kept.as_json()
    lived = (training.learners.tick.to(torch.float64) * training.world.dt).tolist()
    return {
        "seeds": training.seeds,
        **learning_figures(training.episodes, training.seeds, lived),
        **evaluation_figures(last.episodes),
        **reached,
        **evaluations.milestones(),
        "simulated_seconds": lived,
        "ticks": timing.ticks,
        "ticks_per_cpu_s": timing.ticks_per_cpu_s,
        "wall_s": timing.wall_s,
        "cpu_s": timing.cpu_s,
        "startup_s": timing.startup_s,
        "eval_s": timing.eval_s,
        "figures_s": timing.figures_s,
        "not_finite": {
            str(training.seeds[row]): {"place": place, "tick": tick}
            for row, (place, tick) in broken(training).items()
        },
        "versions": versions(),
        "command": command_line(),
    }


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def summary_table(summary: dict[str, Any], title: str) -> Table:
    """Median and extremes over the seeds, for the terminal."""
    table = Table(title=title, title_justify="left")
    table.add_column("over the seeds")
    for name in ("median", "min", "max"):
        table.add_column(name, justify="right")
    rows = (
        ("falls before the first ride", "falls_before_first_ride", 0),
        ("seconds before the first ride", "seconds_before_first_ride", 1),
        ("falls after the first ride", "falls_after_first_ride", 0),
        ("evaluation: reached the goal", "goal_rate", 3),
        ("evaluation: time to the goal, s", "goal_time_s", 1),
        ("evaluation: over the shortest possible", "goal_time_over_shortest", 4),
        ("evaluation: length of path, m", "path_length_m", 1),
    )
    for label, key, digits in rows:
        spread = summary[key]
        if spread["median"] is not None:
            table.add_row(label, *(_number(spread[k], digits) for k in ("median", "min", "max")))
    for key, spread in summary.get("final", {}).items():
        if key != "minutes" and spread["median"] is not None:
            label = f"evaluation: {key.replace('_', ' ')}"
            table.add_row(label, *(_number(spread[k], 4) for k in ("median", "min", "max")))
    return table


def medians(summary: dict[str, Any]) -> dict[str, float]:
    """The medians over the seeds, by TensorBoard tag."""
    return {
        f"summary/{key}": value["median"]
        for key, value in summary.items()
        if isinstance(value, dict) and value.get("median") is not None
    }


def flat_settings(config: Settings) -> dict[str, str | float | bool]:
    """Every leaf of the configuration by its full key, for TensorBoard's table of settings."""
    flat: dict[str, str | float | bool] = {}

    def visit(node: Any, prefix: str) -> None:
        for key, value in node.items():
            if isinstance(value, dict):
                visit(value, f"{prefix}{key}.")
            else:
                plain = isinstance(value, bool | int | float)
                flat[f"{prefix}{key}"] = value if plain else str(value)

    visit(config.plain(), "")
    return flat
