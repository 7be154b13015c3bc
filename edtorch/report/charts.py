"""Figures of a report: where the groups stand, how their seeds spread, how they get there."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from edtorch.report import samples
from edtorch.report.canvas import HUES, INK, NARROW, Chart, blank, panelled, styled
from edtorch.report.comparison import ZERO_FAILURES, Comparison, Estimate, Row
from edtorch.report.legacy import MINUTES
from edtorch.report.quantities import EVALUATION, Quantity, evaluation, learning, to_milestones
from edtorch.report.samples import Array, Sample
from edtorch.report.task_curve import COLOURS

LOGARITHMIC = 20.0
"""Positive values that differ by more than this factor get a logarithmic axis."""
DECADES = 4
"""Where zero has a tick, at most so many others fit beside it."""


def charts(comparison: Comparison) -> list[Chart]:
    """Those that this comparison can fill."""
    prefix = comparison.section.title.replace(": ", "_").replace(" ", "_").lower()
    section = comparison.section.title
    found: list[Chart] = []
    columns = _columns(comparison)
    if columns:
        title = f"{section}: estimates with 95 % intervals"
        found.append(Chart(f"{prefix}_intervals", title, lambda w: _forest(comparison, columns, w)))
    milestones = _estimated(comparison, to_milestones(comparison.section.about))
    if milestones:
        title = f"{section}: paid to a stable policy and to the goal, with 95 % intervals"
        found.append(
            Chart(f"{prefix}_milestones", title, lambda w: _forest(comparison, milestones, w))
        )
    if _costs(comparison):
        words = comparison.section.about.words
        title = f"{section}: share of the seeds that had {words.succeeded}"
        found.append(Chart(f"{prefix}_seeds", title, lambda w: _distributions(comparison, w)))
    curves = _curves(comparison)
    if curves:
        title = f"{section}: evaluations on the way, median and quartiles over the seeds"
        found.append(Chart(f"{prefix}_progress", title, lambda w: _progress(curves, w)))
    return found


@dataclass(frozen=True)
class _Point:
    """What a row of the forest shows; certain: False for a Kaplan-Meier median."""

    value: float
    low: float
    high: float
    certain: bool = True
    at_least: float = math.nan


@dataclass(frozen=True)
class _Column:
    label: str
    points: Mapping[str, _Point]
    share: bool = False


def _point(estimate: Estimate) -> _Point:
    shown = estimate.shown
    certain = estimate.middle is not None
    return _Point(shown.value, shown.low, shown.high, certain, estimate.at_least)


def _estimated(comparison: Comparison, chosen: Sequence[Quantity]) -> list[_Column]:
    """Of those that this comparison has."""
    return [
        _Column(
            quantity.label.removeprefix(EVALUATION),
            {
                row.group.label: _point(row.estimates[quantity.name])
                for row in comparison.rows
                if quantity.name in row.estimates
            },
        )
        for quantity in chosen
        if quantity in comparison.quantities
    ]


def _columns(comparison: Comparison) -> list[_Column]:
    rows, about = comparison.rows, comparison.section.about
    told = [q for q in evaluation(about) if not q.detail]
    columns = _estimated(comparison, (*told, *_costs(comparison)))
    known = dict.fromkeys(name for row in rows for name in row.shares)
    for name in known if comparison.section.searches else known.keys() & {ZERO_FAILURES}:
        points: dict[str, _Point] = {}
        for row in rows:
            if name in row.shares:
                share = row.shares[name].proportion
                points[row.group.label] = _Point(share.rate, *share.wilson())
        words = about.words
        without = f"seeds without a {words.failure} before the first {words.success}"
        label = without if name == ZERO_FAILURES else name
        columns.append(_Column(label.replace("_", " "), points, share=True))
    return columns


def _costs(comparison: Comparison) -> list[Quantity]:
    """Failures and seconds before the first success, where they are known."""
    before = learning(comparison.section.about.words)[:2]
    return [q for q in before if q in comparison.quantities]


def _forest(comparison: Comparison, columns: Sequence[_Column], width: float) -> Figure:
    labels = [row.group.label for row in comparison.rows]
    narrow = width <= NARROW
    with styled(width):
        wrapped = [textwrap.fill(label, 34) for label in labels]
        lines = 1 + max(label.count("\n") for label in wrapped)
        height = 0.9 + (0.42 if narrow else 0.15 + 0.13 * lines) * max(2, len(labels))
        figure, panels = panelled(width, len(columns), height)
        beside = 1 if narrow else min(len(columns), 3)
        for k, (axes, column) in enumerate(zip(panels, columns, strict=True)):
            _forest_panel(axes, column, labels)
            if narrow:
                for y, label in enumerate(labels):
                    place = axes.get_yaxis_transform()
                    axes.text(0, y - 0.22, textwrap.shorten(label, 52), transform=place, size=7)
                axes.set_yticks([])
            elif k % beside == 0:
                axes.set_yticks(range(len(labels)), wrapped)
            else:
                axes.set_yticks(range(len(labels)), [""] * len(labels))
            axes.set_ylim(len(labels) - 0.5, -0.9 if narrow else -0.5)
    return figure


def stretch(axes: Axes, values: Sequence[float]) -> None:
    """A logarithmic axis for what differs by more than ``LOGARITHMIC``, linear from zero to the
    least of the others where there are zeros."""
    positive = [v for v in values if v > 0]
    if not positive or min(values) < 0 or max(positive) / min(positive) <= LOGARITHMIC:
        return
    if len(positive) == len(values):
        axes.set_xscale("log")
    else:
        least = 10.0 ** math.floor(math.log10(min(positive)))
        axes.set_xscale("symlog", linthresh=least, linscale=0.5)
        first, last = math.log10(least), math.ceil(math.log10(max(positive)))
        apart = max(1, math.ceil((last - first) / DECADES))
        axes.set_xticks([0, *10.0 ** np.arange(first, last + 1, apart)])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())


def _forest_panel(axes: Axes, column: _Column, labels: Sequence[str]) -> None:
    ends = [p.at_least for p in column.points.values() if math.isinf(p.value)]
    ends += [v for p in column.points.values() for v in (p.value, p.low, p.high)]
    known = [v for v in ends if math.isfinite(v)]
    if not column.share:
        stretch(axes, known)
    edge = max(known, default=1.0)
    # Room for the arrows of what lies beyond.
    edge *= 1.08 if axes.get_xscale() == "linear" else 1.25
    for y, label in enumerate(labels):
        point = column.points.get(label)
        if point is None:
            continue
        colour = INK if y == 0 else COLOURS[0]
        value = point.value if math.isfinite(point.value) else point.at_least
        low = point.low if math.isfinite(point.low) else value
        high = point.high if math.isfinite(point.high) else edge
        axes.plot([low, high], [y, y], color=colour, linewidth=1.6, solid_capstyle="butt")
        if math.isinf(point.high):
            # Beyond the budget: nobody knows how far.
            axes.plot([high], [y], marker=">", color=colour, markersize=5, clip_on=False)
        face = colour if point.certain else "none"
        axes.plot([value], [y], marker="o", color=colour, markerfacecolor=face, markersize=5)
    first = column.points.get(labels[0])
    if first is not None and math.isfinite(first.value):
        axes.axvline(first.value, color=INK, linewidth=0.7, linestyle=":")
    if column.share:
        axes.xaxis.set_major_formatter(lambda v, _: f"{100 * v:.4g} %")
        axes.locator_params(axis="x", nbins=4)
    axes.set_title(textwrap.fill(column.label, 34))
    axes.grid(axis="x", alpha=0.25)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)


def steps(sample: Sample) -> tuple[Array, Array]:
    """Corners of the share of seeds that is done, one minus Kaplan and Meier's survival; without
    censoring the empirical distribution."""
    share = 1 - samples.survival(sample)
    values = np.concatenate([[sample.lived[0]], sample.lived])
    return values, np.concatenate([[0.0], share])


def _distributions(comparison: Comparison, width: float) -> Figure:
    first, *others = comparison.rows
    # More lines than colours cannot be told apart: they get panels of their own.
    parts = [others[k : k + len(HUES)] for k in range(0, len(others), len(HUES))] or [[]]
    told = _costs(comparison)
    narrow = width <= NARROW
    with styled(width):
        columns = 1 if narrow else len(told)
        longest = max(len(part) for part in parts) + 1
        rows = len(parts) * (len(told) if narrow else 1)
        figure = blank(width, rows * (2.4 + 0.17 * longest))
        panels = list(figure.subplots(rows, columns, squeeze=False).flat)
        for k, axes in enumerate(panels):
            part, quantity = parts[k // len(told)], told[k % len(told)]
            _distribution(axes, quantity, [first, *part])
            _same_axis(axes, quantity, comparison.rows)
            if narrow or k % len(told) == 0:
                axes.set_ylabel("share of the seeds")
            axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), frameon=False, fontsize=7.5)
    return figure


def _same_axis(axes: Axes, quantity: Quantity, rows: Sequence[Row]) -> None:
    """All panels of a quantity can be compared."""
    found = [row.estimates[quantity.name].sample for row in rows if quantity.name in row.estimates]
    low, high = min(s.lived[0] for s in found), max(s.lived[-1] for s in found)
    stretch(axes, [v for s in found for v in s.lived])
    if axes.get_xscale() == "log":
        axes.set_xlim(low / 1.1, high * 1.1)
    elif axes.get_xscale() == "symlog":
        least = min(v for s in found for v in s.lived if v > 0)
        axes.set_xlim(-least / 10, high * 1.5)
    else:
        margin = 0.04 * (high - low) or 0.5
        axes.set_xlim(low - margin, high + margin)


def _distribution(axes: Axes, quantity: Quantity, rows: Sequence[Row]) -> None:
    for row, colour in zip(rows, (INK, *HUES), strict=False):
        if quantity.name not in row.estimates:
            continue
        own = row.estimates[quantity.name].sample
        values, shares = steps(own)
        lost = int(own.censored.sum())
        label = textwrap.shorten(row.group.label, 52)
        label += f" ({lost} of {len(own)} censored)" if lost else ""
        axes.step(values, shares, where="post", color=colour, linewidth=1.4, label=label)
        if lost:
            marks = np.flatnonzero(own.censored) + 1
            axes.plot(values[marks], shares[marks], "|", color=colour, markersize=7)
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlabel(quantity.label)
    axes.grid(alpha=0.25)


@dataclass(frozen=True)
class _Curve:
    """minutes ``[T]``, quartiles ``[3, T]`` over the seeds."""

    minutes: Array
    quartiles: Array


def _curves(comparison: Comparison) -> dict[str, dict[str, _Curve]]:
    """By figure and group, of runs that evaluated more than once."""
    found: dict[str, dict[str, _Curve]] = {}
    for row in comparison.rows:
        times: dict[str, dict[float, list[float]]] = {}
        for run in row.group.runs:
            for there in run.summary.get("evaluations", []):
                for key in there.keys() - {MINUTES}:
                    known = [v for v in there[key].get("per_seed", ()) if v is not None]
                    times.setdefault(key, {}).setdefault(there[MINUTES], []).extend(known)
        for key, values in times.items():
            filled = {minute: own for minute, own in sorted(values.items()) if own}
            if len(filled) > 1:
                quartiles = [np.quantile(own, (0.25, 0.5, 0.75)) for own in filled.values()]
                curve = _Curve(np.array(list(filled)), np.array(quartiles).T)
                found.setdefault(key, {})[row.group.label] = curve
    told = [q for q in evaluation(comparison.section.about) if not q.detail]
    return {q.brief: found[q.path[0]] for q in told if q.path[0] in found}


def _progress(curves: Mapping[str, Mapping[str, _Curve]], width: float) -> Figure:
    labels = list(dict.fromkeys(label for own in curves.values() for label in own))
    with styled(width):
        figure, panels = panelled(width, len(curves), 2.3)
        for axes, (title, own) in zip(panels, curves.items(), strict=True):
            for label, curve in own.items():
                colour = (INK, *HUES)[labels.index(label) % (len(HUES) + 1)]
                low, middle, high = curve.quartiles
                axes.fill_between(curve.minutes, low, high, color=colour, alpha=0.2, linewidth=0)
                axes.plot(curve.minutes, middle, color=colour, linewidth=1.4, label=label)
            axes.set_title(textwrap.fill(title, 34))
            axes.set_xlabel("simulated training time, min")
            axes.set_xlim(left=0)
            axes.grid(alpha=0.25)
        handles, names = panels[0].get_legend_handles_labels()
        columns = 1 if width <= NARROW else 3
        figure.legend(handles, names, loc="outside lower center", frameon=False, ncols=columns)
    return figure
