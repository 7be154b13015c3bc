"""The rerun's runs, and its tables of methods: cost of each milestone beside published figures."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.report import samples
from edtorch.report.comparison import Estimate, estimate
from edtorch.report.document import median_cell
from edtorch.report.domain import Domain
from edtorch.report.groups import Group, places
from edtorch.report.quantities import Quantity, never_there, sample, to_milestone
from edtorch.report.runs import FinishedRun
from edtorch.report.tables import Table, as_markdown
from sims.bicycle.bicycle import PATH_LENGTH, WORDS

FIGURE_2 = "figure_2/bicycle_paper"
FIGURE_3 = ("figure_3/cardea_paper", "figure_3/cardea")


@dataclass(frozen=True)
class Material:
    """runs: by row, ``TABLE/NAME``, those that there are; missing: by cell, why it is not there."""

    runs: Mapping[str, Sequence[FinishedRun]]
    missing: Mapping[str, str]

    @property
    def methods(self) -> list[str]:
        """The rows of the table of methods."""
        rows = [row for row in self.runs if row.startswith("methods/")]
        return [FIGURE_2, *rows] if FIGURE_2 in self.runs else rows

    def lost(self, row: str) -> dict[str, str]:
        """Of a row, the cells that are not there."""
        return {
            title: why
            for title, why in self.missing.items()
            if title == row or title.startswith(f"{row}/")
        }


BICYCLE = Domain("bicycle", WORDS, (PATH_LENGTH,))
TITLES = {"stable": "stable riding", "goal": "the goal"}
TO_STABLE, TO_GOAL = (to_milestone(name, BICYCLE) for name in TITLES)
"""What was paid before a policy first rode in all its fresh episodes, and first to the goal in all
of them; and how long its path then was."""

HOW = (
    "Median over the seeds with its 95 % bootstrap interval"
    f" ({samples.RESAMPLES:,} resamples of the seeds, each method at its own number of them). A"
    " policy is evaluated in new episodes at checkpoints: stable if none of them is a fall, at the"
    " goal if all end there; the cost until then, evaluations not counted. Seeds that never got"
    " there are censored; with more than a quarter of them only the Kaplan-Meier median is given"
    " (KM; > 123: not reached, the median of what was paid). CPU seconds of a population in"
    " lockstep are shared among its learners. Published: texts of the sources, empty where nothing"
    " was; of the methods that learn from short recorded episodes these stand under falls."
)


def _group(runs: Sequence[FinishedRun]) -> Group:
    return Group("", "", {}, {}, tuple(runs), tuple(places(runs)))


def estimates(runs: Sequence[FinishedRun]) -> dict[str, Estimate]:
    """Of every milestone of one row, by the name of the quantity."""
    group = _group(runs)
    found: dict[str, Estimate] = {}
    for quantity in (*TO_STABLE, *TO_GOAL):
        own = sample(quantity, group)
        if own is not None:
            found[quantity.name] = estimate(quantity, own)
    return found


def methods(material: Material, published: Mapping[str, Any]) -> dict[str, Any]:
    """All that the tables are made of, for ``paper.json``."""
    rows: dict[str, Any] = {}
    for row in material.methods:
        runs, name = list(material.runs[row]), row.rpartition("/")[2]
        found = estimates(runs)
        rows[name] = {
            "seeds": [seed for run in runs for seed in run.seeds],
            "lost": material.lost(row),
            "here": {key: one.as_json() for key, one in found.items()},
            "published": published.get(name, {}),
        }
    return rows


def methods_table(material: Material, published: Mapping[str, Any], milestone: str) -> Table:
    """A line for each method: what was paid to a milestone, each figure beside the published."""
    told = [q for q in (*TO_STABLE, *TO_GOAL) if q.milestone == milestone]
    header = ("method", "seeds", "got there")
    for quantity in told:
        header += (quantity.brief, "published")
    rows: list[tuple[str, ...]] = []
    for row in material.methods:
        name = row.rpartition("/")[2]
        theirs = published.get(name, {}).get(milestone, {})
        rows.append((name, *_line(material, row, told, theirs)))
    return Table(f"To {TITLES[milestone]}", header, tuple(rows))


def _line(
    material: Material, row: str, told: Sequence[Quantity], theirs: Mapping[str, Any]
) -> list[str]:
    runs = list(material.runs[row])
    found = estimates(runs)
    size = sum(len(run.seeds) for run in runs)
    some = next((found[q.name] for q in told if q.until and q.name in found), None)
    cells = [str(size) if runs else "missing"]
    cells.append("" if some is None else f"{size - some.censored} of {size}")
    if runs and some is None:
        cells[1] = "no milestones in its summary"
    for quantity in told:
        own = found.get(quantity.name)
        key = quantity.path[-1].removesuffix("_length_m").replace("failures", "falls")
        cells += ["" if own is None else median_cell(own), str(theirs.get(key, ""))]
    return cells


LEARNING = (
    "Median [least, most] over the seeds that got there, exploration and learning going on; a ride"
    " is an episode to the goal or to the time limit."
)
LEARNT = {
    "ride": (("failures_before_first_success",), "falls before the first ride"),
    "goal": (("first_goal", "episodes"), "episodes up to the first to the goal"),
    "seconds": (("first_goal", "seconds"), "that episode, s"),
}
"""What is published of episodes of learning: where it stands in a summary, and its title."""


def learnt(material: Material, published: Mapping[str, Any]) -> dict[str, Any]:
    """Of the methods of which that is published, each seed's; None for one that never got there."""
    found: dict[str, Any] = {}
    for row in material.methods:
        name = row.rpartition("/")[2]
        theirs = published.get(name, {}).get("learning")
        if theirs is None or not material.runs[row]:
            continue
        group = _group(material.runs[row])
        own = {key: group.per_seed(*path) for key, (path, _) in LEARNT.items()}
        # Without a ride, what is told is all that was paid.
        own["ride"] = [
            None if never else falls
            for falls, never in zip(own["ride"], never_there(group), strict=True)
        ]
        found[name] = {"published": theirs, **own}
    return found


def _learnt_table(found: Mapping[str, Any]) -> Table:
    header: tuple[str, ...] = ("method",)
    for _, title in LEARNT.values():
        header += (title, "published")
    rows = []
    for name, own in found.items():
        cells = [name]
        for key in LEARNT:
            cells += [_seeds(own[key]), str(own["published"].get(key, ""))]
        rows.append(tuple(cells))
    return Table("While learning", header, tuple(rows))


def _seeds(values: Sequence[float | None]) -> str:
    """Median [least, most] of those that got there, and how many did."""
    there = [v for v in values if v is not None]
    if not there:
        return f"0 of {len(values)}"
    middle, least, most = (f"{v:,.0f}" for v in (statistics.median(there), min(there), max(there)))
    return f"{middle} [{least}, {most}], {len(there)} of {len(values)}"


def blocks(
    material: Material, published: Mapping[str, Any], learning: Mapping[str, Any]
) -> list[str]:
    """The chapter of ``paper.md``; learning: of ``learnt``."""
    sources = [f"* {name}: {row['source']}" for name, row in published.items()]
    found = [
        HOW,
        *(
            f"### To {title}\n\n{as_markdown(methods_table(material, published, name))}"
            for name, title in TITLES.items()
        ),
    ]
    if learning:
        found += ["### While learning", LEARNING, as_markdown(_learnt_table(learning))]
    return [*found, "Sources of what is published:\n\n" + "\n".join(sources)]
