"""Charts of a sweep: a curve over one setting, a map over two, parallel coordinates over more."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from edtorch.report.canvas import INK, NARROW, PAPER, Chart, blank, panelled, styled
from edtorch.report.charts import LOGARITHMIC
from edtorch.report.comparison import Estimate
from edtorch.report.quantities import EVALUATION, Quantity
from edtorch.report.sweep import Axis
from edtorch.report.sweep_view import Spot, SweepView, ranked
from edtorch.report.task_curve import COLOURS
from edtorch.report.text import number

SHADES = 32
MOST_WRITTEN = 80
"""Cells of a map in which numbers are written."""
GREY, FRAME = "#9a9fa6", "#e4572e"
"""Of what has no number, and around the best."""
_TICKS = (0.0, 0.25, 0.5, 0.75, 1.0)


def sweep_charts(view: SweepView) -> list[Chart]:
    """One, where there is a quantity to draw."""
    if not view.quantities:
        return []
    told = view.comparison.section.title
    keys = " and ".join(axis.key for axis in view.axes)
    name = re.sub(r"\W+", "_", f"sweep_{view.sweep.name}_{told}").lower()
    if len(view.axes) == 1:
        title = f"{told}, by {keys}: estimates over the seeds with 95 % intervals"
        return [Chart(name, title, lambda width: _curves(view, width))]
    if len(view.axes) == 2:
        title = f"{told}, by {keys}: estimates over the seeds, shaded by rank; the best has a frame"
        return [Chart(name, title, lambda width: _maps(view, width))]
    brief = _brief(view.judged_by)
    title = f"{told}: a line for each setting, to its rank by {brief}; the best is broad"
    return [Chart(name, title, lambda width: _parallel(view, width))]


def _brief(quantity: Quantity) -> str:
    return quantity.label.removeprefix(EVALUATION)


def _wide(values: Sequence[float]) -> bool:
    """Whether they want a logarithmic scale."""
    return bool(values) and min(values) > 0 and max(values) / min(values) > LOGARITHMIC


def _numbers(values: Sequence[str]) -> list[float] | None:
    """None where one is none."""
    try:
        found = [float(value) for value in values]
    except ValueError:
        return None
    return found if all(map(math.isfinite, found)) else None


def _curves(view: SweepView, width: float) -> Figure:
    (axis,) = view.axes
    with styled(width):
        figure, panels = panelled(width, len(view.quantities), 2.6)
        for axes, quantity in zip(panels, view.quantities, strict=True):
            found = {place[0]: each for place, each in view.estimates(quantity).items()}
            _curve(axes, axis, found)
            axes.set_title(textwrap.fill(_brief(quantity), 34))
            axes.set_xlabel(axis.key)
            axes.grid(alpha=0.25)
    return figure


def _curve(axes: Axes, axis: Axis, found: Mapping[str, Estimate]) -> None:
    numbers = _numbers(axis.values)
    places = list(range(len(axis.values))) if numbers is None else numbers
    shown = [each.shown for each in found.values()]
    ends = [v for each in shown for v in (each.value, each.low, each.high)]
    ends += [each.at_least for each in found.values() if math.isinf(each.shown.value)]
    known = [v for v in ends if math.isfinite(v)]
    if _wide(known):
        axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    top = max(known, default=1.0)
    top += 0.08 * (top - min(known, default=0.0))
    middle: list[tuple[float, float]] = []
    for place, value in zip(places, axis.values, strict=True):
        if value not in found:
            continue
        each = found[value]
        shown = each.shown
        at = shown.value if math.isfinite(shown.value) else each.at_least
        low = shown.low if math.isfinite(shown.low) else at
        high = shown.high if math.isfinite(shown.high) else top
        axes.plot([place, place], [low, high], color=COLOURS[0], linewidth=1.6)
        if math.isinf(shown.high):
            # Beyond the budget: nobody knows how far.
            axes.plot([place], [high], marker="^", color=COLOURS[0], markersize=5, clip_on=False)
        face = COLOURS[0] if each.middle is not None else "none"
        axes.plot([place], [at], marker="o", color=COLOURS[0], markerfacecolor=face, markersize=5)
        middle.append((place, at))
    if numbers is None:
        labels = [textwrap.shorten(v, 16) for v in axis.values]
        turned = {"rotation": 25, "ha": "right"} if len("".join(labels)) > 24 else {}
        axes.set_xticks(places, labels, **turned)
        axes.set_xlim(-0.5, len(places) - 0.5)
        return
    axes.plot(*zip(*middle, strict=True), color=COLOURS[0], linewidth=0.8)
    if _wide(numbers):
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")


@dataclass(frozen=True)
class _Ranks:
    """Values by rank, from 0, the least, to 1: one that is far from the others, as the return of a
    learner that has failed, does not hide how these differ."""

    values: tuple[float, ...]

    def of(self, value: float) -> float:
        """In the middle of those that are equal."""
        below = sum(v < value for v in self.values)
        equal = self.values.count(value)
        return (below + (equal - 1) / 2) / max(1, len(self.values) - 1)

    def at(self, share: float) -> float:
        """The value at a rank."""
        return float(np.quantile(self.values, share))


def _shades(quantity: Quantity) -> Colormap:
    """From the least to the most; what is better is darker."""
    name = "viridis_r" if quantity.more_is_better else "viridis"
    return matplotlib.colormaps[name].resampled(SHADES)


def _finite(found: Mapping[Spot, Estimate]) -> dict[Spot, float]:
    values = {place: each.shown.value for place, each in found.items()}
    return {place: value for place, value in values.items() if math.isfinite(value)}


def _short(value: float) -> str:
    return number(float(f"{value:.3g}"))


def _written(each: Estimate) -> str:
    value = each.shown.value
    return _short(value) if math.isfinite(value) else f"> {_short(each.at_least)}"


def _maps(view: SweepView, width: float) -> Figure:
    across, up = view.axes
    if len(up.values) > len(across.values):
        across, up = up, across
    with styled(width):
        panels_beside = 1 if width <= NARROW else min(len(view.quantities), 3)
        cell = min(0.45, width / panels_beside / (len(across.values) + 3))
        figure, panels = panelled(
            width, len(view.quantities), 1.3 + max(0.3, cell) * (len(up.values) + 1)
        )
        for axes, quantity in zip(panels, view.quantities, strict=True):
            _map(axes, view, quantity, across, up)
            axes.set_title(textwrap.fill(_brief(quantity), 34))
    return figure


def _map(axes: Axes, view: SweepView, quantity: Quantity, across: Axis, up: Axis) -> None:
    found = view.estimates(quantity)
    values = _finite(found)
    shades, ranks = _shades(quantity), _Ranks(tuple(values.values()))
    best = ranked(view)[0]
    cells = len(across.values) * len(up.values)
    flip = view.axes[0] is up
    grid = np.full((len(up.values), len(across.values)), np.nan)
    for row, y in enumerate(up.values):
        for column, x in enumerate(across.values):
            place = (y, x) if flip else (x, y)
            known = place in values
            if known:
                grid[row, column] = ranks.of(values[place])
            text = view.lost.get(place, "-")
            if place in found:
                text = _written(found[place])
            if not known:
                axes.add_patch(_cell(column, row, facecolor=GREY, alpha=0.25, linewidth=0))
            if place == best:
                axes.add_patch(_cell(column, row, fill=False, edgecolor=FRAME, linewidth=2.5))
            if cells <= MOST_WRITTEN:
                colour = _on(shades(grid[row, column])) if known else INK
                axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=7.5)
    edges = (np.arange(len(axis.values) + 1) - 0.5 for axis in (across, up))
    known = np.ma.masked_invalid(grid)
    mesh = axes.pcolormesh(*edges, known, cmap=shades, vmin=0, vmax=1, zorder=0, edgecolors="face")
    if cells > MOST_WRITTEN and len(set(values.values())) > 1:
        bar = axes.figure.colorbar(mesh, ax=axes)
        bar.set_ticks(list(_TICKS), labels=[_short(ranks.at(share)) for share in _TICKS])
    for ticks, axis in ((axes.set_xticks, across), (axes.set_yticks, up)):
        labelled = _labelled(axis.values)
        ticks([axis.values.index(v) for v in labelled], [textwrap.shorten(v, 14) for v in labelled])
    axes.set_xlabel(across.key)
    axes.set_ylabel(up.key)


def _cell(column: int, row: int, **style: object) -> Rectangle:
    return Rectangle((column - 0.5, row - 0.5), 1, 1, **style)  # pyright: ignore


def _on(colour: tuple[float, float, float, float]) -> str:
    """Black or white, whichever can be read on it."""
    red, green, blue, _ = colour
    return "#000000" if 0.3 * red + 0.59 * green + 0.11 * blue > 0.5 else "#ffffff"


def _parallel(view: SweepView, width: float) -> Figure:
    """A line for each place: through its values, to what it came to."""
    quantity = view.judged_by
    found = view.estimates(quantity)
    values = _finite(found)
    shades, ranks = _shades(quantity), _Ranks(tuple(values.values()))
    order = ranked(view)
    narrow = width <= NARROW
    last = len(view.axes)
    with styled(width):
        figure = blank(width, 3.4 if narrow else 3.8)
        axes = figure.subplots()
        for place in reversed(order):  # the best on top
            heights = [_height(axis, value) for axis, value in zip(view.axes, place, strict=True)]
            known = place in values
            # Beyond every budget lies above the scale, or below it where more is better.
            beyond = -0.08 if quantity.more_is_better else 1.08
            end = ranks.of(values[place]) if known else beyond
            axes.plot(
                range(last + 1),
                [*heights, end],
                color=shades(end) if known else GREY,
                linestyle="-" if known else ":",
                linewidth=3.0 if place == order[0] else 1.0,
                alpha=1.0 if place == order[0] else 0.75,
            )
        for k, axis in enumerate(view.axes):
            axes.axvline(k, color=INK, linewidth=0.7)
            for value in _labelled(axis.values):
                height = _height(axis, value)
                text = textwrap.shorten(value, 14)
                _label(axes, k + 0.03, height, text)
        axes.axvline(last, color=INK, linewidth=0.7)
        before = -1.0
        for value in sorted(set(values.values())):
            if (share := ranks.of(value)) - before > 0.06:
                _label(axes, last + 0.03, share, _short(value))
                before = share
        names = [*(axis.key for axis in view.axes), _brief(quantity)]
        wrapped = [textwrap.fill(name.replace(".", ". "), 12 if narrow else 20) for name in names]
        axes.set_xticks(range(last + 1), [name.replace(". ", ".") for name in wrapped])
        axes.set_xlim(-0.05, last + 0.35)
        axes.set_ylim(-0.14, 1.14)
        axes.set_yticks([])
        for side in ("top", "right", "left", "bottom"):
            axes.spines[side].set_visible(False)
        axes.tick_params(axis="x", length=0)
    return figure


def _label(axes: Axes, x: float, y: float, text: str) -> None:
    behind = {"facecolor": PAPER, "edgecolor": "none", "pad": 1.0, "alpha": 0.8}
    axes.text(x, y, text, va="center", fontsize=7.5, color=INK, bbox=behind, zorder=5)


def _height(axis: Axis, value: str) -> float:
    """From 0 to 1: the values of an axis are evenly spaced."""
    return axis.values.index(value) / max(1, len(axis.values) - 1)


def _labelled(values: Sequence[str], most: int = 8) -> Sequence[str]:
    """So many of them that they can be read."""
    return values[:: math.ceil(len(values) / most)]
