"""What the figures of a report are drawn on: ink, letters, panels for a page and for a phone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from edtorch.report.task_curve import COLOURS

INK = "#222222"
"""Of everything but the data; a page may replace it."""
PAPER = "#fefefe"
"""Behind letters that lie on lines; a page may replace it."""
HUES = (*COLOURS, "#c8901c")
"""For a baseline there is the ink."""
WIDE, NARROW = 9.0, 3.7
"""Inches: of a page, and of a phone."""


@dataclass(frozen=True)
class Chart:
    """A figure that can be drawn at any width; name: of its files; title: what it shows, in words
    that stand for it where it cannot be seen."""

    name: str
    title: str
    draw: Callable[[float], Figure]


@contextmanager
def styled(width: float) -> Iterator[None]:
    """Meanwhile figures have the ink and the letters of a report; width: theirs, in inches."""
    size = 9 if width > NARROW else 8
    with matplotlib.rc_context(
        {
            "font.size": size,
            "axes.titlesize": size + 1,
            "text.color": INK,
            "axes.edgecolor": INK,
            "axes.labelcolor": INK,
            "xtick.color": INK,
            "ytick.color": INK,
        }
    ):
        yield


def blank(width: float, height: float) -> Figure:
    """An empty figure, in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def panelled(width: float, panels: int, height: float) -> tuple[Figure, list[Axes]]:
    """Side by side on a page, one below the other on a phone."""
    narrow = width <= NARROW
    columns = 1 if narrow else min(panels, 3)
    rows = math.ceil(panels / columns)
    figure = blank(width, height * rows)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for empty in axes[panels:]:
        empty.set_axis_off()
    return figure, axes[:panels]
