"""The figures of a sweep where its settings put them, and which settings were best."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from edtorch.report import samples
from edtorch.report.comparison import Comparison, Estimate, Row
from edtorch.report.groups import UNSET
from edtorch.report.quantities import Quantity, evaluation, learning
from edtorch.report.sweep import DONE, Axis, SweepJob, SweepTable, axes_of

DRAWN = 3
"""So many quantities are drawn of a sweep."""

Spot = tuple[str, ...]
"""One value for each axis."""


@dataclass(frozen=True)
class SweepView:
    """A sweep in one section of a report.

    rows: of the section, by their places; lost: the statuses of jobs without a result, by theirs;
    quantities: what is drawn, first what the settings are judged by; empty where nothing can be.
    """

    sweep: SweepTable
    comparison: Comparison
    axes: tuple[Axis, ...]
    rows: Mapping[Spot, Row]
    lost: Mapping[Spot, str]
    quantities: tuple[Quantity, ...]

    @property
    def judged_by(self) -> Quantity:
        """The quantity that ranks the settings."""
        return self.quantities[0]

    def estimates(self, quantity: Quantity) -> dict[Spot, Estimate]:
        """Of a quantity, where there are any."""
        found = {place: row.estimates.get(quantity.name) for place, row in self.rows.items()}
        return {place: each for place, each in found.items() if each is not None}


def views(sweep: SweepTable, comparisons: list[Comparison]) -> Iterator[SweepView]:
    """Of the sweep in each section that has runs of it, where it varies anything."""
    by_folder = {job.folder.resolve(): job for job in sweep.jobs if job.folder is not None}
    inside = [(c, _jobs(c, by_folder)) for c in comparisons]
    inside = [(comparison, jobs) for comparison, jobs in inside if jobs]
    for comparison, jobs in inside:
        # Which section a job without a result would be in is only known where there is one.
        others = sweep.unfinished if len(inside) == 1 else []
        axes = axes_of([*(job for _, job in jobs), *others])
        if axes:
            rows = {_place(job, axes): row for row, job in jobs}
            lost = {_place(job, axes): job.status for job in others}
            yield SweepView(sweep, comparison, tuple(axes), rows, lost, _told(comparison, rows))


def _jobs(comparison: Comparison, jobs: Mapping[Path, SweepJob]) -> list[tuple[Row, SweepJob]]:
    found: list[tuple[Row, SweepJob]] = []
    for row in comparison.rows:
        own = (jobs.get(run.path.resolve()) for run in row.group.runs)
        found += [(row, job) for job in own if job is not None and job.status == DONE]
    return found


def _place(job: SweepJob, axes: list[Axis]) -> Spot:
    return tuple(job.settings.get(axis.key) or UNSET for axis in axes)


def _told(comparison: Comparison, rows: Mapping[Spot, Row]) -> tuple[Quantity, ...]:
    """What the settings are judged by, and others of an overview.

    They are judged by the seconds before the first success, where these differ, or else by what
    fresh episodes brought.
    """
    about = comparison.section.about
    failures, seconds, _ = learning(about.words)
    fresh = [q for q in evaluation(about) if not q.detail]
    known = [q for q in (seconds, *fresh, failures) if q in comparison.quantities]

    def values(quantity: Quantity) -> set[float]:
        found = (row.estimates.get(quantity.name) for row in rows.values())
        shown = {each.shown.value for each in found if each is not None}
        return set(filter(math.isfinite, shown))

    known = [q for q in known if values(q)]
    judges = [q for q in known if q is seconds or q.more_is_better] + known
    first = next((q for q in judges if len(values(q)) > 1), next(iter(judges), None))
    return () if first is None else (first, *(q for q in known if q is not first))[:DRAWN]


def ranked(view: SweepView) -> list[Spot]:
    """The settings, best first, by the interquartile mean or what stands for it; ties by the next
    quantity.  None where no quantity judges them."""
    if not view.quantities:
        return []
    every = [(-1 if q.more_is_better else 1, view.estimates(q)) for q in view.quantities]

    def merit(place: Spot) -> list[float]:
        known = ((sign, found.get(place)) for sign, found in every)
        return [math.inf if each is None else sign * each.shown.value for sign, each in known]

    return sorted(view.estimates(view.judged_by), key=merit)


def beside_the_best(view: SweepView) -> Iterator[tuple[Spot, Estimate]]:
    """The ranked settings with what judges them, and their difference from the best."""
    order, found = ranked(view), view.estimates(view.judged_by)
    for place in order:
        own, best = found[place].sample, found[order[0]].sample
        difference = None if place == order[0] else samples.difference(own, best)
        yield place, replace(found[place], difference=difference)
