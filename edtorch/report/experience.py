"""The figure of a search: success against experience."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from edtorch.report.proportions import Proportion


@dataclass(frozen=True)
class SeedExperience:
    """One seed: ``seconds`` of experience after each trial, rates: the success of the policy then
    in fresh episodes; solved: seconds when its task first counted as solved, inf for never."""

    seconds: Sequence[float]
    rates: Sequence[float]
    solved: float


def experience_curve(seeds: Sequence[SeedExperience], wanted: float | None, title: str) -> Figure:
    """Above: the share of the seeds whose task is solved against seconds of experience, with
    Wilson's 95 % band.  Below: the success of each seed's policy after each trial; wanted: the rate
    that counts as solved, None where another figure decides."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    FigureCanvasAgg(figure)
    share, rates = figure.subplots(2, 1, sharex=True)
    last = max((s for seed in seeds for s in seed.seconds), default=1.0)
    end = 1.1 * last
    moments = sorted({0.0, end, *(s for seed in seeds for s in seed.seconds)})
    proportions = [
        Proportion(sum(seed.solved <= moment for seed in seeds), len(seeds)) for moment in moments
    ]
    low, high = zip(*(p.wilson() for p in proportions), strict=True)
    share.fill_between(moments, low, high, step="post", color="#2a6fb3", alpha=0.2, linewidth=0)
    share.step(moments, [p.rate for p in proportions], where="post", color="#2a6fb3")
    share.set_ylabel("share of seeds solved")
    for seed in seeds:
        rates.plot(seed.seconds, seed.rates, color="#3d8c4f", alpha=0.5, marker="o", markersize=3)
    if wanted is not None:
        rates.axhline(wanted, color="#b3402a", linewidth=0.8, linestyle="--")
        rates.annotate(
            "solved", (0.01, wanted), xycoords=("axes fraction", "data"), ha="left", va="top"
        )
    rates.set_ylabel("success in fresh episodes")
    rates.set_xlabel("experience, s (random trials included)")
    for axes in (share, rates):
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlim(0, end)
        axes.grid(alpha=0.2)
    figure.suptitle(title)
    return figure


def median_seconds(values: Sequence[float]) -> float:
    """Median with unsolved seeds as infinity."""
    return statistics.median(values)
