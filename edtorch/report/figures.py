"""The learning curve of one run: the two graphs of the paper's Figure 2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from edtorch.run.checkpoint import write_atomically
from edtorch.run.episodes import Episode
from sims.base import Outcome

MARKS = {
    Outcome.FAILED: ("x", "#b3402a", "fell"),
    Outcome.TIMED_OUT: ("s", "#c8901c", "rode to the time limit"),
    Outcome.SUCCEEDED: ("o", "#2a6fb3", "reached the goal"),
}


@dataclass(frozen=True)
class Ride:
    """One state component along one episode: seconds ``[T]``, values ``[T]`` in ``unit``.

    period: that of an angle that wraps, else 0.
    """

    seconds: np.ndarray
    values: np.ndarray
    name: str
    unit: str
    title: str
    period: float = 0.0


def unwrapped_strokes(
    seconds: np.ndarray, values: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """The curve with a gap (NaN) wherever an angle wraps, so that no line crosses the circle."""
    if period <= 0:
        return seconds, values
    wraps = np.flatnonzero(np.abs(np.diff(values)) > period / 2) + 1
    return np.insert(seconds, wraps, seconds[wraps]), np.insert(values, wraps, math.nan)


def learning_curve(episodes: Sequence[Episode], rows: int, ride: Ride | None, title: str) -> Figure:
    """Length of episode against training time, one line a learner; below, one ride.

    The dashed line is the median of the shortest times that the starts of the successful episodes
    allow, where the sim knows them.
    """
    figure = Figure(figsize=(8, 8 if ride is not None else 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 if ride is not None else 1, 1, squeeze=False)
    _lengths(panels[0, 0], episodes, rows)
    figure.suptitle(title)
    if ride is not None:
        _one_ride(panels[1, 0], ride)
    return figure


def episode_lengths(
    episodes: Sequence[Episode], rows: int, title: str, shortest: float | None = None
) -> Figure:
    """The upper graph alone; shortest: where the dashed line is, if the episodes do not tell."""
    figure = Figure(figsize=(8, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    _lengths(figure.subplots(), episodes, rows, shortest)
    figure.suptitle(title)
    return figure


def one_ride(ride: Ride, title: str) -> Figure:
    """The lower graph alone."""
    figure = Figure(figsize=(8, 4), layout="constrained")
    FigureCanvasAgg(figure)
    _one_ride(figure.subplots(), ride)
    figure.suptitle(title)
    return figure


def _shortest(episodes: Sequence[Episode]) -> float | None:
    """Median of what the starts of the successful episodes allow."""
    measured = [
        e.measures.get("shortest_time_s", math.nan)
        for e in episodes
        if e.outcome is Outcome.SUCCEEDED
    ]
    known = [s for s in measured if math.isfinite(s)]
    return float(np.median(known)) if known else None


def _lengths(axes, episodes: Sequence[Episode], rows: int, shortest: float | None = None) -> None:
    for row in range(rows):
        own = [e for e in episodes if e.row == row]
        ends = [e.start + e.seconds for e in own]
        axes.plot(ends, [e.seconds for e in own], color="#8a94a0", linewidth=0.6, alpha=0.6)
    for outcome, (marker, colour, label) in MARKS.items():
        some = [e for e in episodes if e.outcome is outcome]
        if some:
            axes.scatter(
                [e.start + e.seconds for e in some],
                [e.seconds for e in some],
                marker=marker,
                s=16,
                linewidths=0.9,
                color=colour,
                label=f"{label} ({len(some)})",
                zorder=3,
            )
    best = _shortest(episodes) if shortest is None else shortest
    if best is not None:
        axes.axhline(best, linestyle="--", color="#333333", linewidth=1)
        axes.annotate(
            f"shortest\npossible,\n{best:.0f} s",
            (1, best),
            xycoords=("axes fraction", "data"),
            xytext=(5, 0),
            textcoords="offset points",
            verticalalignment="center",
            fontsize=9,
        )
    if episodes:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1, 0.4)))
    axes.set_xlim(left=0)
    axes.set_xlabel("simulated training time, s")
    axes.set_ylabel("length of episode, s")
    axes.grid(alpha=0.25)
    if episodes:
        # Above the plot, which the marks fill from the lower left to the upper right.
        place = (0.5, 1.0)
        axes.legend(loc="lower center", bbox_to_anchor=place, ncols=3, frameon=False, fontsize=9)
    else:
        axes.text(0.5, 0.5, "no episode has ended", transform=axes.transAxes, ha="center")
        axes.set_yticks([])


def _one_ride(axes, ride: Ride) -> None:
    degrees = ride.unit == "rad"
    seconds, values = unwrapped_strokes(ride.seconds, ride.values, ride.period)
    axes.plot(seconds, np.degrees(values) if degrees else values, color="#2a6fb3", linewidth=1)
    axes.axhline(0, color="#333333", linewidth=0.8)
    axes.set_title(ride.title, fontsize=10)
    axes.set_xlabel("time in the episode, s")
    unit = "degrees" if degrees else ride.unit
    label = ride.name.replace("_", " ")
    axes.set_ylabel(f"{label}, {unit}" if unit != "1" else label)
    axes.grid(alpha=0.25)


def save_figure(figure: Figure, folder: Path, name: str) -> None:
    """As ``name.png`` and ``name.svg``."""
    for kind in ("png", "svg"):
        write_atomically(
            folder / f"{name}.{kind}",
            lambda partial, kind=kind: figure.savefig(partial, format=kind, dpi=130),
        )
