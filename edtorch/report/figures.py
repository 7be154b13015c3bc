"""The learning curve of one run, as the two graphs of the paper's Figure 2."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from edtorch.report.domain import Domain
from edtorch.run.episodes import Episode
from edtorch.run.files import write_atomically
from sims.base import DEFAULT_WORDS, Outcome

MARKS = {
    Outcome.FAILED: ("x", "#b3402a"),
    Outcome.TIMED_OUT: ("s", "#c8901c"),
    Outcome.SUCCEEDED: ("o", "#2a6fb3"),
}


@dataclass(frozen=True)
class Trace:
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


@dataclass(frozen=True)
class Height:
    """What a learning curve shows of each episode: its value, and the label and scale of the axis;
    line: a value to compare with, and its label."""

    value: Callable[[Episode], float]
    label: str
    logarithmic: bool = False
    line: tuple[float, str] | None = None


def length(shortest: float | None = None) -> Height:
    """Length of episode; shortest: the least that a success can take, s."""
    line = None if shortest is None else (shortest, f"shortest\npossible,\n{shortest:.0f} s")
    return Height(lambda e: e.seconds, "length of episode, s", True, line)


def total_reward(domain: Domain) -> Height:
    """Return of each episode."""
    return Height(lambda e: e.total_reward, domain.return_label)


def height(domain: Domain, shortest: float | None, episodes: Sequence[Episode]) -> Height:
    """The length of episodes, where a domain measures how long a success takes; else the return, if
    there is one."""
    timed = any(measure.successes and measure.unit == "s" for measure in domain.measures)
    known = any(math.isfinite(e.total_reward) for e in episodes)
    return total_reward(domain) if known and not timed else length(shortest)


def endings(domain: Domain) -> dict[Outcome, str]:
    """What the ends of its episodes are called."""
    words = domain.words
    named = domain.survival and words.succeeded != DEFAULT_WORDS.succeeded
    return {
        Outcome.FAILED: words.failed,
        Outcome.TIMED_OUT: f"{words.succeeded} to the time limit" if named else "time limit",
        Outcome.SUCCEEDED: "reached the goal" if domain.survival else words.succeeded,
    }


def learning_curve(
    episodes: Sequence[Episode],
    rows: int,
    domain: Domain,
    shown: Height,
    trace: Trace | None,
    title: str,
) -> Figure:
    """Height of each episode against training time, one line a learner; below, one episode."""
    figure = Figure(figsize=(8, 8 if trace is not None else 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 if trace is not None else 1, 1, squeeze=False)
    _heights(panels[0, 0], episodes, rows, domain, shown)
    figure.suptitle(title)
    if trace is not None:
        _one_episode(panels[1, 0], trace)
    return figure


def one_episode(trace: Trace, title: str) -> Figure:
    """The lower graph alone."""
    figure = Figure(figsize=(8, 4), layout="constrained")
    FigureCanvasAgg(figure)
    _one_episode(figure.subplots(), trace)
    figure.suptitle(title)
    return figure


def shortest_time(episodes: Sequence[Episode], measure: str) -> float | None:
    """Median of what the starts of the successful episodes allow; measure: ``Spec.shortest``."""
    measured = [
        e.measures.get(measure, math.nan) for e in episodes if e.outcome is Outcome.SUCCEEDED
    ]
    known = [s for s in measured if math.isfinite(s)]
    return float(np.median(known)) if known else None


def _heights(
    axes: Axes, episodes: Sequence[Episode], rows: int, domain: Domain, shown: Height
) -> None:
    for row in range(rows):
        own = [e for e in episodes if e.row == row]
        ends = [e.start + e.seconds for e in own]
        values = [shown.value(e) for e in own]
        axes.plot(ends, values, color="#8a94a0", linewidth=0.6, alpha=0.6)
    labels = endings(domain)
    for outcome, (marker, colour) in MARKS.items():
        some = [e for e in episodes if e.outcome is outcome]
        if some:
            axes.scatter(
                [e.start + e.seconds for e in some],
                [shown.value(e) for e in some],
                marker=marker,
                s=16,
                linewidths=0.9,
                color=colour,
                label=f"{labels[outcome]} ({len(some)})",
                zorder=3,
            )
    if shown.line is not None:
        value, label = shown.line
        axes.axhline(value, linestyle="--", color="#333333", linewidth=1)
        axes.annotate(
            label,
            (1, value),
            xycoords=("axes fraction", "data"),
            xytext=(5, 0),
            textcoords="offset points",
            verticalalignment="center",
            fontsize=9,
        )
    if episodes and shown.logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1, 0.4)))
    axes.set_xlim(left=0)
    axes.set_xlabel("simulated training time, s")
    axes.set_ylabel(shown.label)
    axes.grid(alpha=0.25)
    if episodes:
        # Above the plot, which the marks fill from the lower left to the upper right.
        place = (0.5, 1.0)
        axes.legend(loc="lower center", bbox_to_anchor=place, ncols=3, frameon=False, fontsize=9)
    else:
        axes.text(0.5, 0.5, "no episode has ended", transform=axes.transAxes, ha="center")
        axes.set_yticks([])


def _one_episode(axes: Axes, trace: Trace) -> None:
    degrees = trace.unit == "rad"
    seconds, values = unwrapped_strokes(trace.seconds, trace.values, trace.period)
    axes.plot(seconds, np.degrees(values) if degrees else values, color="#2a6fb3", linewidth=1)
    axes.axhline(0, color="#333333", linewidth=0.8)
    axes.set_title(trace.title, fontsize=10)
    axes.set_xlabel("time in the episode, s")
    unit = "degrees" if degrees else trace.unit
    label = trace.name.replace("_", " ")
    axes.set_ylabel(f"{label}, {unit}" if unit != "1" else label)
    axes.grid(alpha=0.25)


def save_figure(figure: Figure, folder: Path, name: str) -> None:
    """As ``name.png`` and ``name.svg``."""
    for kind in ("png", "svg"):
        write_atomically(
            folder / f"{name}.{kind}",
            lambda partial, kind=kind: figure.savefig(partial, format=kind, dpi=130),
        )
