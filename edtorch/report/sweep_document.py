"""What a report says of a sweep."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any

from edtorch.report.comparison import Comparison, Estimate
from edtorch.report.document import Part, cell, difference_cell
from edtorch.report.sweep import DONE, SweepJob, SweepTable, varied
from edtorch.report.sweep_charts import sweep_charts
from edtorch.report.sweep_view import Spot, SweepView, beside_the_best, views
from edtorch.report.tables import Table
from edtorch.report.text import NONE

LISTED = 10
"""Settings in the table of the best."""
BEST_NOTE = (
    "The difference is from the best, with its interval; where that holds zero, the seeds cannot"
    " tell the two apart. The best of many settings looks better than it is, for its seeds have"
    " chosen it: try it again with others."
)


def sweep_part(sweep: SweepTable, comparisons: Sequence[Comparison]) -> Part:
    """Charts, the best settings, and the jobs without a result."""
    own = list(views(sweep, list(comparisons)))
    return Part(
        f"Sweep {sweep.name}",
        (_counted(sweep), *(_varied(view) for view in own)),
        tuple(chart for view in own for chart in sweep_charts(view)),
        (*(best_table(view) for view in own if view.quantities), *_lost(sweep)),
    )


def _counted(sweep: SweepTable) -> str:
    counts = Counter(job.status for job in sweep.jobs)
    listed = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    left = "" if set(counts) == {DONE} else " What is not done is not in the figures."
    return f"{len(sweep.jobs)} jobs in {sweep.folder}: {listed}.{left}"


def _varied(view: SweepView) -> str:
    axes = ", ".join(f"{axis.key} ({len(axis.values)} values)" for axis in view.axes)
    return f"{view.comparison.section.title}: varies {axes}."


def best_table(view: SweepView) -> Table:
    """The best settings, with their figures over the seeds."""
    judged, *others = view.quantities
    header = (
        "rank",
        "seeds",
        *(axis.key for axis in view.axes),
        judged.brief,
        "difference",
        *(q.brief for q in others),
    )
    best = itertools.islice(beside_the_best(view), LISTED)
    rows = [_row(view, k, place, each) for k, (place, each) in enumerate(best, 1)]
    title = f"{view.comparison.section.title}: the best settings by {judged.brief}"
    return Table(title, header, tuple(rows), BEST_NOTE)


def _row(view: SweepView, rank: int, place: Spot, judged: Estimate) -> tuple[str, ...]:
    estimates = view.rows[place].estimates
    others = (estimates.get(quantity.name) for quantity in view.quantities[1:])
    return (
        f"{rank}.",
        str(len(judged.sample)),
        *place,
        cell(judged),
        difference_cell(judged),
        *(NONE if each is None else cell(each) for each in others),
    )


def _lost(sweep: SweepTable) -> list[Table]:
    lost = sweep.unfinished
    if not lost:
        return []
    keys = [axis.key for axis in varied(sweep.jobs)]
    rows = tuple((_name(job), _settings(job, keys), job.status, job.why or NONE) for job in lost)
    return [Table("Jobs that are not done", ("job", "settings", "status", "why"), rows)]


def _name(job: SweepJob) -> str:
    return NONE if job.folder is None else job.folder.name


def _settings(job: SweepJob, keys: Sequence[str]) -> str:
    return " ".join(f"{key}={job.settings[key]}" for key in keys if key in job.settings) or NONE


def sweep_json(sweep: SweepTable, comparisons: Sequence[Comparison]) -> dict[str, Any]:
    """For ``report.json``."""
    return {
        "folder": str(sweep.folder),
        "jobs": [
            {
                "folder": None if job.folder is None else str(job.folder),
                "status": job.status,
                "why": job.why,
                "settings": dict(job.settings),
            }
            for job in sweep.jobs
        ],
        "sections": [_view_json(view) for view in views(sweep, list(comparisons))],
    }


def _view_json(view: SweepView) -> dict[str, Any]:
    return {
        "section": view.comparison.section.title,
        "axes": {axis.key: list(axis.values) for axis in view.axes},
        "judged_by": view.judged_by.name if view.quantities else None,
        "ranked": [
            {
                "settings": {a.key: v for a, v in zip(view.axes, place, strict=True)},
                "group": view.rows[place].group.label,
                "seeds": len(each.sample),
                "estimate": each.shown.as_json(),
                "difference": None if each.difference is None else each.difference.as_json(),
            }
            for place, each in (beside_the_best(view) if view.quantities else ())
        ],
    }
