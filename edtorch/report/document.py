"""A report as headings, paragraphs, tables and charts, whatever they are then rendered as."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from edtorch.report import samples
from edtorch.report.canvas import Chart
from edtorch.report.charts import charts
from edtorch.report.comparison import (
    SUCCEEDED,
    ZERO_FAILURES,
    Comparison,
    Estimate,
    Row,
    Share,
)
from edtorch.report.groups import shown
from edtorch.report.proportions import Proportion
from edtorch.report.quantities import (
    EVALUATION,
    FAILURES,
    TITLES,
    Quantity,
    evaluation,
    learning,
    to_milestones,
)
from edtorch.report.runs import LeftOut
from edtorch.report.samples import Interval
from edtorch.report.tables import Table
from edtorch.report.text import NEVER, NONE, number

HOW_TO_READ = (
    "The seed is the unit: every figure is one number per learner, whatever it did in between.",
    "Brackets are 95 % intervals: of shares Wilson's, of everything else percentile bootstraps over"
    f" the seeds ({samples.RESAMPLES:,} resamples, stratified by group, the same at every call).",
    "IQM is the interquartile mean: the mean of the middle half of the seeds.",
    "A learner without a success within its budget is censored: its failures and seconds before the"
    " first success are only known to be more than it has paid, and it counts as worse than every"
    f" learner with one ({NEVER!r} where that decides a bound). Where more than a quarter of the"
    " seeds is censored only the Kaplan-Meier median is given, marked KM; where it is not reached,"
    " > gives the median of what has been paid.",
    "A return sums the rewards of an episode: the environment's own, or where it has none the"
    " configured reward, which shapes the learning (shaping reward, summed over time).",
)


OVERVIEW_NOTE = (
    "Evaluation in fresh episodes first, then what the learning cost; IQM over the seeds with its"
    " 95 % interval."
)
NOTHING_LEARNED = "does not learn"


@dataclass(frozen=True)
class Part:
    """A heading with what stands below it.  folded: of interest to few."""

    heading: str
    paragraphs: tuple[str, ...] = ()
    charts: tuple[Chart, ...] = ()
    tables: tuple[Table, ...] = ()
    folded: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Document:
    """The whole report; made: the line that says by what."""

    title: str
    parts: tuple[Part, ...]
    made: str


def document(
    comparisons: Sequence[Comparison],
    left_out: Sequence[LeftOut],
    title: str,
    made: str,
    sweeps: Sequence[Part] = (),
) -> Document:
    """Put a report together; sweeps: what comes first."""
    parts = [*sweeps, *(_section(comparison) for comparison in comparisons)]
    parts.append(Part("How to read this", HOW_TO_READ))
    if left_out:
        rows = tuple((str(item.path), item.why) for item in left_out)
        table = Table("Left out", ("folder", "why"), rows)
        parts.append(Part("Left out", tables=(table,)))
    return Document(title, tuple(parts), made)


def _section(comparison: Comparison) -> Part:
    return Part(
        comparison.section.title,
        charts=tuple(charts(comparison)),
        tables=tuple(
            [overview(comparison), *milestone_tables(comparison), *_against_baseline(comparison)]
        ),
        folded=(*_details(comparison), _settings(comparison), _runs(comparison)),
    )


def _bracket(interval: Interval, digits: int | None) -> str:
    return f"[{number(interval.low, digits)}, {number(interval.high, digits)}]"


def _median(estimate: Estimate) -> str:
    digits = estimate.quantity.digits
    if math.isinf(estimate.median.value):
        return f"> {number(estimate.at_least, digits)}"
    return f"{number(estimate.median.value, digits)} {_bracket(estimate.median, digits)}"


def _censored(estimate: Estimate) -> str:
    return f"({estimate.censored} of {len(estimate.sample)} censored)"


def _cell(row: Row, quantity: Quantity) -> str:
    """Of the overview."""
    estimate = row.estimates.get(quantity.name)
    return NONE if estimate is None else cell(estimate)


def cell(estimate: Estimate) -> str:
    """The IQM with its interval, or what there is instead."""
    quantity = estimate.quantity
    lost = f" {_censored(estimate)}" if estimate.censored else ""
    if estimate.middle is None:
        return f"KM {_median(estimate)}{lost}"
    digits = quantity.digits
    # The middle half does not tell of the one learner that went wrong.
    worst = "" if quantity.until else f", worst {number(estimate.worst, digits)}"
    return (
        f"{number(estimate.middle.value, digits)} {_bracket(estimate.middle, digits)}{worst}{lost}"
    )


def median_cell(estimate: Estimate) -> str:
    """The median with its interval, by Kaplan and Meier where some are censored."""
    lost = f" {_censored(estimate)}" if estimate.censored else ""
    mark = "KM " if estimate.middle is None else ""
    return f"{mark}{_median(estimate)}{lost}"


def percent(share: float, total: int) -> str:
    """With as many digits as so many can tell."""
    digits = max(0, math.ceil(math.log10(total)) - 2) if total > 1 else 0
    return f"{100 * share:.{digits + 1}f}"


def proportion(share: Proportion) -> str:
    """In per cent, with Wilson's interval."""
    rate, low, high = (percent(v, share.total) for v in (share.rate, *share.wilson()))
    return f"{rate} % [{low}, {high}]"


def overview(comparison: Comparison) -> Table:
    """A line for each group."""
    title = f"{comparison.section.title}, overview"
    if comparison.section.searches:
        return _search_overview(comparison, title)
    evaluated = [q for q in comparison.quantities if _is_headline(q)]
    paid = [q for q in learning(comparison.section.about.words) if q in comparison.quantities]
    words = comparison.section.about.words
    header = ("group", "seeds", *(q.brief for q in evaluated))
    fails = any(q.path in FAILURES for q in comparison.quantities)
    if paid:
        header += (words.succeeded, *([f"no {words.failure} before"] if fails else []))
        header += tuple(q.brief for q in paid)
    header += ("CPU s per seed",)
    rows: list[tuple[str, ...]] = []
    for row in comparison.rows:
        cells = [row.group.label, str(len(row.group.seeds))]
        cells += [_cell(row, quantity) for quantity in evaluated]
        if paid:
            cells += [_succeeded(row), *([_zero_failures(row)] if fails else [])]
            cells += [_cell(row, q) for q in paid]
        cpu = row.cpu_s
        cells.append(NONE if cpu is None else number(cpu / _trained(row), 2))
        rows.append(tuple(cells))
    return Table(title, header, tuple(rows), OVERVIEW_NOTE)


def _succeeded(row: Row) -> str:
    if not row.group.learns:
        return NOTHING_LEARNED
    share = row.shares.get(SUCCEEDED)
    return NONE if share is None else str(share.proportion.count)


def _zero_failures(row: Row) -> str:
    share = row.shares.get(ZERO_FAILURES)
    return NONE if share is None else proportion(share.proportion)


def _trained(row: Row) -> int:
    """Learners that the CPU seconds went into: a repeated seed cost again."""
    return sum(len(run.seeds) for run in row.group.runs)


def _is_headline(quantity: Quantity) -> bool:
    """Whether it stands in the overview: rates, return and the sim's first measures."""
    return quantity.label.startswith(EVALUATION) and not quantity.detail


MILESTONES_NOTE = (
    "Policies are tried at checkpoints, in fresh episodes that cost no experience. What a seed had"
    " paid at its first checkpoint where none of them failed (a stable policy), and where all of"
    " them ended at the goal; the moment itself lies between it and the checkpoint before. IQM over"
    " the seeds with its 95 % interval; censored: seeds that were never there."
)


def milestone_tables(comparison: Comparison) -> list[Table]:
    """What was paid until policies were stable, and until they were at the goal."""
    told = [q for q in to_milestones(comparison.section.about) if q in comparison.quantities]
    if not told:
        return []
    header = ("group", "seeds")
    header += tuple(f"to {TITLES[q.milestone]}: {q.brief}" for q in told)
    rows = [
        (row.group.label, str(len(row.group.seeds)), *(_cell(row, q) for q in told))
        for row in comparison.rows
    ]
    title = f"{comparison.section.title}, milestones"
    return [Table(title, header, tuple(rows), MILESTONES_NOTE)]


def _search_overview(comparison: Comparison, title: str) -> Table:
    names = list(dict.fromkeys(name for row in comparison.rows for name in row.shares))
    totals = ("episodes", "simulated_seconds", "cpu_s")
    header = ("group", "seeds", "policies", *(name.replace("_", " ") for name in names))
    measured = {f"{q.brief} (at the goal)": q.path[-1] for q in _of_successes(comparison)}
    header += (*measured, *(name.replace("_", " ") for name in totals))
    rows: list[tuple[str, ...]] = []
    for row in comparison.rows:
        shares = [row.shares.get(name) for name in names]
        size = max(share.proportion.total for share in row.shares.values())
        medians = [run.summary.get("median_of_goal_policies", {}) for run in row.group.runs]
        sums = [row.total(name) for name in totals]
        rows.append(
            (
                row.group.label,
                str(len(row.group.seeds)),
                f"{size:,}",
                *(NONE if share is None else _of(share) for share in shares),
                *(", ".join(number(own.get(key)) for own in medians) for key in measured.values()),
                *(NONE if total is None else number(total, 0) for total in sums),
            )
        )
    return Table(title, header, tuple(rows), "Shares with Wilson 95 % intervals.")


def _of_successes(comparison: Comparison) -> list[Quantity]:
    """What the policies of a search that always reach the goal have medians of."""
    runs = [run for row in comparison.rows for run in row.group.runs]
    known = {key for run in runs for key in run.summary.get("median_of_goal_policies", {})}
    about = comparison.section.about
    names = [m.name for m in about.measures if m.successes and m.better != "neither"]
    return [q for q in evaluation(about) if q.path[-1] in names and q.path[-1] in known]


def _of(share: Share) -> str:
    return f"{share.proportion.count:,}: {proportion(share.proportion)}"


def _against_baseline(comparison: Comparison) -> list[Table]:
    """What changes from the first group to the others."""
    first, *others = comparison.rows
    if not others:
        return []
    title = f"{comparison.section.title}, beside {first.group.label!r}"
    if comparison.section.searches:
        names = list(dict.fromkeys(name for row in others for name in row.shares))
        header = ("group", *(f"{name.replace('_', ' ')}: difference, p" for name in names))
        rows = [
            (row.group.label, *(_against(row, first, name) for name in names)) for row in others
        ]
        note = "p: two-proportion z test that the two shares are one."
        return [Table(title, header, tuple(rows), note)]
    costs = learning(comparison.section.about.words)
    told = [q for q in comparison.quantities if _is_headline(q) or q in costs]
    header = ("group",)
    for quantity in told:
        header += (f"{quantity.brief}: difference", "better")
    rows = []
    for row in others:
        cells: list[str] = []
        for quantity in told:
            estimate = row.estimates.get(quantity.name)
            cells += (
                [NONE, NONE] if estimate is None else [difference_cell(estimate), _better(estimate)]
            )
        rows.append((row.group.label, *cells))
    note = (
        "Difference: of the interquartile means, group minus baseline (none where more than a"
        " quarter is censored). Better: probability that a learner of the group does better than"
        " one of the baseline."
    )
    return [Table(title, header, tuple(rows), note)]


def _against(row: Row, first: Row, name: str) -> str:
    if name not in row.shares or name not in first.shares:
        return NONE
    share, base = row.shares[name], first.shares[name]
    points = 100 * (share.proportion.rate - base.proportion.rate)
    p = share.p
    return f"{points:+.3g} points" + ("" if p is None else f", p = {p:.2g}")


def difference_cell(estimate: Estimate) -> str:
    """The difference with its interval."""
    found, digits = estimate.difference, estimate.quantity.digits
    if found is None:
        return NONE
    sign = "+" if found.value > 0 else ""

    def bound(value: float) -> str:
        return "unknown" if math.isinf(value) else number(value, digits)

    ends = f"[{bound(found.low)}, {bound(found.high)}]"
    return f"{sign}{number(found.value, digits)} {ends}"


def _better(estimate: Estimate) -> str:
    found = estimate.better
    return NONE if found is None else f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"


def _details(comparison: Comparison) -> list[Table]:
    """A table for each quantity, with every estimate."""
    header = (
        "group",
        "seeds",
        "censored",
        "median",
        "IQM",
        "mean",
        "least",
        "95th percentile",
        "most",
    )
    header += ("difference of IQM", "better than the baseline")
    return [
        Table(
            quantity.label,
            header,
            tuple(
                _detail(row.group.label, row.estimates[quantity.name])
                for row in comparison.rows
                if quantity.name in row.estimates
            ),
        )
        for quantity in comparison.quantities
    ]


def _detail(label: str, estimate: Estimate) -> tuple[str, ...]:
    found, digits = estimate.as_json(), estimate.quantity.digits
    middle = estimate.middle

    def extreme(value: float | None) -> str:
        return NEVER if value is None else number(value, digits)

    return (
        label,
        str(len(estimate.sample)),
        str(estimate.censored),
        _median(estimate),
        NONE if middle is None else f"{number(middle.value, digits)} {_bracket(middle, digits)}",
        NONE if estimate.censored else number(float(estimate.sample.lived.mean()), digits),
        *(extreme(found[key]) for key in ("min", "p95", "max")),
        difference_cell(estimate),
        _better(estimate),
    )


def _settings(comparison: Comparison) -> Table:
    """In which settings the groups differ."""
    keys = list(comparison.rows[0].group.differing)
    rows = [
        (
            row.group.label,
            ", ".join(shown(key, row.group.differing[key]) for key in keys) or "no difference",
        )
        for row in comparison.rows
    ]
    return Table("Settings in which the groups differ", ("group", "settings"), tuple(rows))


def _runs(comparison: Comparison) -> Table:
    """Where the figures come from."""
    header = ("group", "folder", "seeds", "command", "torch", "commit")
    rows: list[tuple[str, ...]] = []
    for row in comparison.rows:
        for run in row.group.runs:
            about = {**run.about, **run.summary}
            torch = (about.get("versions") or {}).get("torch", NONE)
            told = (about.get("command") or NONE, torch, (about.get("git") or NONE)[:12])
            rows.append((row.group.label, str(run.path), ranges(run.seeds), *told))
    return Table("Runs", header, tuple(rows))


def ranges(seeds: Sequence[int]) -> str:
    """``0-3, 7``."""
    spans: list[list[int]] = []
    for seed in sorted(seeds):
        if spans and seed == spans[-1][1] + 1:
            spans[-1][1] = seed
        else:
            spans.append([seed, seed])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in spans)
