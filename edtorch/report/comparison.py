"""All numbers of a report: per group with intervals, and beside the baseline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from edtorch.report import samples
from edtorch.report.groups import Group, Section
from edtorch.report.proportions import Proportion, same_rate
from edtorch.report.quantities import Quantity, quantities, sample, succeeded, zero_failures
from edtorch.report.runs import shares_of
from edtorch.report.samples import Interval, Sample

ZERO_FAILURES, SUCCEEDED = "zero_failure_rate", "succeeded"


@dataclass(frozen=True)
class Estimate:
    """One quantity of one group.

    sample: the values of the seeds that have it; middle: the interquartile mean, None where more
    than a quarter is censored and ``median`` (Kaplan-Meier) is all there is to tell; difference,
    better: beside the baseline: of the interquartile means, and the probability that a learner is
    better than one of the baseline.  None for the baseline itself.
    """

    quantity: Quantity
    sample: Sample
    median: Interval
    middle: Interval | None
    difference: Interval | None
    better: Interval | None

    @property
    def censored(self) -> int:
        """How many seeds never got there."""
        return int(self.sample.censored.sum())

    @property
    def shown(self) -> Interval:
        """The interquartile mean, or else the median."""
        return self.middle if self.middle is not None else self.median

    @property
    def worst(self) -> float:
        """Of all seeds."""
        ranked = self.sample.ranked
        return float(ranked[0] if self.quantity.more_is_better else ranked[-1])

    @property
    def at_least(self) -> float:
        """A bound on the median that needs no assumption: that of what has been paid so far."""
        return float(samples.median(self.sample.lived))

    def as_json(self) -> dict[str, Any]:
        """For ``report.json``."""
        ranked = self.sample.ranked
        most, p95 = (v if math.isfinite(v) else None for v in (ranked[-1], quantile(ranked, 0.95)))
        return {
            "seeds": len(self.sample),
            "censored": self.censored,
            "median": self.median.as_json(),
            "median_by": "Kaplan-Meier" if self.censored else "order",
            "median_at_least": self.at_least,
            "interquartile_mean": _json(self.middle),
            "mean": None if self.censored else float(self.sample.lived.mean()),
            "min": float(ranked[0]) if math.isfinite(ranked[0]) else None,
            "p95": p95,
            "max": most,
            "difference": _json(self.difference),
            "probability_of_improvement": _json(self.better),
        }


@dataclass(frozen=True)
class Share:
    """So many of so many; p: that the baseline's is the same, None for the baseline itself."""

    proportion: Proportion
    p: float | None

    def as_json(self) -> dict[str, Any]:
        """For ``report.json``."""
        return {**self.proportion.as_json(), "p_same_as_baseline": self.p}


@dataclass(frozen=True)
class Row:
    """A group with its numbers."""

    group: Group
    estimates: Mapping[str, Estimate]
    shares: Mapping[str, Share]

    @property
    def cpu_s(self) -> float | None:
        """CPU seconds of the learning, or of the search, of all its runs; None where not told."""
        return self.total("cpu_s")

    def total(self, key: str) -> float | None:
        """The sum of a figure that each run has once."""
        found = [run.summary.get(key) for run in self.group.runs]
        numbers = [v for v in found if isinstance(v, int | float)]
        return sum(numbers) if len(numbers) == len(found) else None


@dataclass(frozen=True)
class Comparison:
    """A section with its numbers; the first row is the baseline."""

    section: Section
    quantities: tuple[Quantity, ...]
    rows: tuple[Row, ...]


def quantile(ranked: samples.Array, q: float) -> float:
    """The value that a share ``q`` does not exceed: one of the values, infinite ones included."""
    return float(ranked[min(len(ranked) - 1, math.ceil(q * len(ranked)) - 1)])


def _json(interval: Interval | None) -> dict[str, float | None] | None:
    return None if interval is None else interval.as_json()


def compare(section: Section) -> Comparison:
    """The numbers of a section."""
    return _compare_searches(section) if section.searches else _compare_learners(section)


def estimate(quantity: Quantity, own: Sample, baseline: Sample | None = None) -> Estimate:
    """Of a quantity in one group, beside the baseline if there is one."""
    median = (
        samples.kaplan_meier_median(own)
        if own.censored.any()
        else samples.interval(own, samples.median)
    )
    heavy = own.heavily_censored
    difference = better = None
    if baseline is not None:
        difference = samples.difference(own, baseline)
        better = samples.probability_less(own, baseline)
        if quantity.more_is_better:
            better = Interval(1 - better.value, 1 - better.high, 1 - better.low)
    return Estimate(
        quantity=quantity,
        sample=own,
        median=median,
        middle=None if heavy else samples.interval(own, samples.interquartile_mean),
        difference=difference,
        better=better,
    )


def _compare_learners(section: Section) -> Comparison:
    told = quantities(section)
    rows: list[Row] = []
    for group in section.groups:
        base = rows[0] if rows else None
        estimates: dict[str, Estimate] = {}
        for quantity in told:
            own = sample(quantity, group)
            if own is not None:
                other = None if base is None else base.estimates.get(quantity.name)
                against = None if other is None else other.sample
                estimates[quantity.name] = estimate(quantity, own, against)
        found = {ZERO_FAILURES: zero_failures(group), SUCCEEDED: succeeded(group)}
        shares = _shares({name: share for name, share in found.items() if share}, base)
        rows.append(Row(group, estimates, shares))
    return Comparison(section, tuple(told), tuple(rows))


def _shares(own: Mapping[str, Proportion], base: Row | None) -> dict[str, Share]:
    return {
        name: Share(
            share,
            None
            if base is None or name not in base.shares
            else same_rate(share, base.shares[name].proportion),
        )
        for name, share in own.items()
    }


def _compare_searches(section: Section) -> Comparison:
    rows: list[Row] = []
    for group in section.groups:
        runs = [shares_of(run.summary) for run in group.runs]
        pooled = {
            name: Proportion(
                sum(run[name]["count"] for run in runs), sum(run[name]["total"] for run in runs)
            )
            for name in runs[0]
            if all(name in run for run in runs)
        }
        rows.append(Row(group, {}, _shares(pooled, rows[0] if rows else None)))
    return Comparison(section, (), tuple(rows))


def as_json(comparison: Comparison) -> dict[str, Any]:
    """For ``report.json``."""
    return {
        "domain": comparison.section.domain,
        "kind": "searches" if comparison.section.searches else "learners",
        "baseline": comparison.rows[0].group.label,
        "groups": [_row_json(row) for row in comparison.rows],
    }


def _row_json(row: Row) -> dict[str, Any]:
    return {
        "label": row.group.label,
        "name": row.group.name,
        "settings": dict(row.group.differing),
        "seeds": row.group.seeds,
        "learns": row.group.learns,
        "cpu_s": row.cpu_s,
        "shares": {name: share.as_json() for name, share in row.shares.items()},
        "quantities": {name: found.as_json() for name, found in row.estimates.items()},
        "runs": [_run_json(run) for run in row.group.runs],
    }


def _run_json(run: Any) -> dict[str, Any]:
    about = {**run.about, **run.summary}
    return {
        "folder": str(run.path),
        "seeds": run.seeds,
        **{key: about.get(key) for key in ("command", "versions", "git", "cpu_s", "wall_s")},
    }


def compare_all(sections: Sequence[Section]) -> list[Comparison]:
    """Each on its own."""
    return [compare(section) for section in sections]
