"""The outcome of a run: ``summary.json``, the table at the end, TensorBoard's table of settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from rich.table import Table

from edtorch.app.evaluations import Evaluations, Learned
from edtorch.app.settings import Settings
from edtorch.learner.learner import Check
from edtorch.report.domain import Domain
from edtorch.report.quantities import evaluation, learning, told_of
from edtorch.report.quantities import training as training_quantities
from edtorch.report.statistics import (
    aliases,
    by_row,
    evaluation_figures,
    first_success_figures,
    generic_figures,
    is_defined,
)
from edtorch.report.text import number
from edtorch.run.episodes import Episode
from edtorch.run.milestones import FirstSuccess, first_success
from edtorch.run.snapshot_log import Snapshots
from edtorch.run.success import settled
from edtorch.run.training import Training

_PARTS = ("wall", "cpu", "startup", "eval", "figures")


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

    def as_json(self) -> dict[str, Any]:
        """For ``summary.json``."""
        seconds = {f"{name}_s": getattr(self, f"{name}_s") for name in _PARTS}
        return {"ticks": self.ticks, "ticks_per_cpu_s": self.ticks_per_cpu_s, **seconds}


def broken(training: Learned) -> dict[int, tuple[str, int]]:
    """Learners whose numbers were not finite somewhere: the first place, the first tick."""
    rows = (~training.finite).any(0).nonzero().flatten().tolist()
    sound_ticks = training.learners.sound_ticks.tolist()
    places = training.finite.to(torch.int8).argmin(0).tolist()
    return {row: (Check(places[row]).name.lower(), sound_ticks[row]) for row in rows}


def result_figures(
    domain: Domain,
    seeds: Sequence[int],
    fresh: Sequence[Sequence[Episode]],
    lived: Sequence[Sequence[Episode]],
    first: Sequence[FirstSuccess],
) -> dict[str, Any]:
    """What every ``summary.json`` holds of its seeds.

    fresh: episodes of the evaluation; lived: those of the learning, where they were kept; first:
    what the learning paid for its first success, empty for a method that does not learn.
    """
    figures: dict[str, Any] = {"seeds": list(seeds), "domain": domain.as_json()}
    if first and is_defined([*fresh, *lived], domain.survival):
        figures |= first_success_figures(first, seeds)
        figures |= aliases(figures, domain.words)
    if any(lived):
        figures["training"] = generic_figures(lived)
    return figures | evaluation_figures(fresh, domain.measures, domain.words)


def not_finite(job: Learned) -> dict[str, Any]:
    """``broken`` for ``summary.json``, by seed."""
    return {
        str(job.seeds[row]): {"place": place, "tick": tick}
        for row, (place, tick) in broken(job).items()
    }


def summarise(training: Training, evaluations: Evaluations) -> dict[str, Any]:
    """Of a population, after at least one evaluation in full: that of the end."""
    lived = (training.learners.tick.to(torch.float64) * training.world.dt).tolist()
    last = evaluations.done[-1]
    everything = [*training.episodes, *(e for each in last.episodes for e in each)]
    own = by_row(settled(training.episodes, everything), len(training.seeds))
    first = [first_success(each, seconds) for each, seconds in zip(own, lived, strict=True)]
    lost = sum(training.lost_episodes)
    return {
        **result_figures(evaluations.domain, training.seeds, last.episodes, own, first),
        **({"lost_episodes": lost} if lost else {}),
        **evaluations.as_json(),
        "simulated_seconds": lived,
        "not_finite": not_finite(training),
    }


def summary_table(summary: Mapping[str, Any], domain: Domain, title: str) -> Table:
    """Median and extremes over the seeds, for the terminal."""
    table = Table(title=title, title_justify="left")
    table.add_column("over the seeds")
    for name in ("median", "min", "max"):
        table.add_column(name, justify="right")
    every = (*evaluation(domain), *learning(domain.words), *training_quantities(domain))
    for quantity in told_of(domain, summary, every):
        spread: Any = summary
        for key in quantity.path:
            spread = spread[key]
        cells = (number(spread[name], quantity.digits) for name in ("median", "min", "max"))
        table.add_row(quantity.label, *cells)
    return table


def snapshots_of(domain: Domain) -> Snapshots:
    """Entries on the way, with what the domain counts."""
    survival = domain.survival is not None
    return Snapshots(domain.words, can_fail=domain.can_fail, can_succeed=survival)


def never_succeeded(summary: Mapping[str, Any], domain: Domain, most: int = 20) -> str | None:
    """The line that names the seeds without a success while learning; None without any."""
    seeds = summary.get("never_succeeded")
    if not seeds:
        return None
    listed = ", ".join(map(str, seeds[:most]))
    more = f" and {len(seeds) - most} more" if len(seeds) > most else ""
    return f"never {domain.words.succeeded} while learning: seeds {listed}{more}"


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
