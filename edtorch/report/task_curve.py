"""The learning curve of a family of tasks: the graph of the paper's Figure 3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from edtorch.report.domain import Domain
from edtorch.run.episodes import Episode
from sims.base import Outcome

COLOURS = ("#2a6fb3", "#b3402a", "#3d8c4f", "#8a5ab3")
PANELS = 2
"""So many of the measures that a domain declares first are shown."""
FAILURE_RATE = "failure_rate"


@dataclass(frozen=True)
class Curve:
    """Seconds ``[T]`` at the middles of spans of time; lower quartile, median and upper quartile
    ``[3, T]`` over the seeds of each seed's mean over the episodes that ended in the span."""

    seconds: np.ndarray
    quartiles: np.ndarray


def curve(episodes: Sequence[Episode], rows: int, spans: int, measure: str) -> Curve:
    """That of a measure, or of the share of episodes that failed, ``FAILURE_RATE``."""
    ends = np.array([e.start + e.seconds for e in episodes])
    owners = np.array([e.row for e in episodes])
    if measure == FAILURE_RATE:
        values = np.array([float(e.outcome is Outcome.FAILED) for e in episodes])
    else:
        values = np.array([e.measures[measure] for e in episodes])
    edges = np.linspace(0, ends.max(), spans + 1)
    span = np.minimum(np.searchsorted(edges, ends, side="left") - 1, spans - 1)
    means = np.full((rows, spans), np.nan)
    for row in range(rows):
        for k in range(spans):
            mine = values[(owners == row) & (span == k)]
            if len(mine):
                means[row, k] = mine.mean()
    filled = ~np.isnan(means).all(0)
    quartiles = np.nanquantile(means[:, filled], (0.25, 0.5, 0.75), axis=0)
    return Curve((0.5 * (edges[1:] + edges[:-1]))[filled], quartiles)


def task_curve(
    runs: Mapping[str, tuple[Sequence[Episode], int]],
    domain: Domain,
    title: str,
    seconds_a_span: float = 20.0,
) -> Figure:
    """The domain's first measures at the ends of the episodes, and the share that failed, against
    time.

    runs: by name, the finished episodes of a population and its size.  Lines are medians over the
    seeds, bands their quartiles.
    """
    shown = domain.measures[:PANELS]
    names = [*(measure.name for measure in shown), FAILURE_RATE]
    figure = Figure(figsize=(8, 3 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for (name, (episodes, rows)), colour in zip(runs.items(), COLOURS, strict=False):
        last = max((e.start + e.seconds for e in episodes), default=0.0)
        if last == 0:
            continue
        spans = max(1, min(120, round(last / seconds_a_span)))
        for axes, measure in zip(panels, names, strict=True):
            found = curve(episodes, rows, spans, measure)
            low, middle, high = found.quartiles
            minutes = found.seconds / 60
            axes.fill_between(minutes, low, high, color=colour, alpha=0.2, linewidth=0)
            axes.plot(minutes, middle, color=colour, linewidth=1.4, label=name)
    for axes, measure in zip(panels, shown, strict=False):
        if all((line.get_ydata() > 0).all() for line in axes.lines):
            axes.set_yscale("log")
        axes.set_ylabel(measure.with_unit)
    panels[-1].set_ylabel(f"share of {domain.words.failures}")
    panels[-1].set_ylim(-0.02, 1.02)
    panels[-1].set_xlabel("simulated training time, min")
    for axes in panels:
        axes.grid(alpha=0.25)
        axes.set_xlim(left=0)
    if len(runs) > 1:
        panels[0].legend(frameon=False, fontsize=9)
    figure.suptitle(title)
    return figure
