"""Which figures a table shows of learners, with which labels and digits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from edtorch.report.domain import RETURN, Domain
from edtorch.report.groups import Group, Section
from edtorch.report.proportions import Proportion
from edtorch.report.samples import Sample
from sims.base import Words

EVALUATION = "evaluation: "
_MILESTONES = "milestones"
"""Where they stand in ``summary.json``."""


@dataclass(frozen=True)
class Quantity:
    """A figure with one value per seed.

    path: where it stands in ``summary.json``; brief: its label where there is little room; digits:
    after the point, None: five significant ones; more_is_better: how a learner improves on another;
    until: it counts up to the first success, or to the milestone of this name, and is censored for
    a learner that never was there; after: such a learner has none; learning: only a method that
    learns has it; detail: not for overviews.
    """

    path: tuple[str, ...]
    label: str
    brief: str
    digits: int | None = None
    more_is_better: bool = False
    until: str = ""
    after: str = ""
    learning: bool = False
    detail: bool = False

    @property
    def name(self) -> str:
        """In ``report.json``."""
        return ".".join(self.path)

    @property
    def milestone(self) -> str:
        """Which one it belongs to; "" for none."""
        return self.path[1] if self.path[0] == _MILESTONES else ""


SUCCESS = "success"
"""The first one, as a place that quantities count up to."""


def learning(words: Words) -> tuple[Quantity, Quantity, Quantity]:
    """Failures and seconds before the first success, and failures after it."""
    failures, first = words.failures, f"the first {words.success}"
    return (
        Quantity(
            ("failures_before_first_success",),
            f"{failures} before {first}",
            f"{failures} before",
            1,
            until=SUCCESS,
            learning=True,
        ),
        Quantity(
            ("seconds_before_first_success",),
            f"seconds before {first}",
            "seconds before",
            1,
            until=SUCCESS,
            learning=True,
        ),
        Quantity(
            ("failures_after_first_success",),
            f"{failures} after {first}",
            f"{failures} after",
            1,
            after=SUCCESS,
            learning=True,
        ),
    )


def rates(words: Words) -> tuple[Quantity, Quantity]:
    """Shares of the fresh episodes that failed, and that succeeded."""
    failed, succeeded = f"{words.failure} rate", f"{words.success} rate"
    return (
        Quantity(("failure_rate",), EVALUATION + failed, failed, 4),
        Quantity(("success_rate",), EVALUATION + succeeded, succeeded, 4, more_is_better=True),
    )


HEADLINES = 2
"""So many measures of a sim stand in overviews: those that it declares first."""


def evaluation(domain: Domain) -> tuple[Quantity, ...]:
    """Of fresh episodes: what every domain has, and what this one measures."""
    failed, succeeded = rates(domain.words)
    label = domain.return_label
    measured = tuple(
        Quantity(
            (m.name,),
            EVALUATION + m.with_unit,
            m.with_unit,
            more_is_better=m.better == "higher",
            detail=place >= HEADLINES,
        )
        for place, m in enumerate(domain.measures)
        if m.better != "neither"
    )
    length = "length of episode, s"
    episode = Quantity(("episode_s",), EVALUATION + length, "episode, s", detail=True)
    earned = Quantity((RETURN,), EVALUATION + label, label, more_is_better=True)
    return (failed, earned, succeeded, *measured, episode)


def training(domain: Domain) -> tuple[Quantity, ...]:
    """Of the episodes of the learning itself, exploration included."""
    return tuple(
        Quantity(
            ("training", *quantity.path),
            quantity.label.replace(EVALUATION, "training: "),
            f"training: {quantity.brief}",
            quantity.digits,
            quantity.more_is_better,
            learning=True,
        )
        for quantity in evaluation(replace(domain, measures=()))
        if quantity.path != ("success_rate",)
    )


TITLES = {"stable": "a stable policy", "goal": "the goal"}
"""Of the milestones, as in "what was paid to ..."."""


def to_milestone(name: str, domain: Domain) -> tuple[Quantity, ...]:
    """What was paid before a policy first was there in all its fresh episodes; and how its
    successful episodes were there, where a success is needed to be there."""
    to = TITLES[name]

    def paid(key: str, what: str, digits: int) -> Quantity:
        path = (_MILESTONES, name, key)
        return Quantity(path, f"{what} to {to}", what, digits, until=name)

    there = tuple(
        Quantity(
            (_MILESTONES, name, m.name),
            f"{m.with_unit}: the first policy at {to}",
            m.with_unit,
            after=name,
        )
        for m in domain.measures
        if m.successes and m.better != "neither" and name == "goal"
    )
    return (
        paid("failures", domain.words.failures, 1),
        paid("seconds", "simulated seconds", 1),
        paid("cpu_s", "CPU seconds", 2),
        *there,
    )


def to_milestones(domain: Domain) -> tuple[Quantity, ...]:
    """Of all milestones."""
    return tuple(q for name in TITLES for q in to_milestone(name, domain))


def every(domain: Domain) -> tuple[Quantity, ...]:
    """All that a report may show of a domain, in order."""
    return (
        *evaluation(domain),
        *learning(domain.words),
        *training(domain),
        *to_milestones(domain),
    )


FAILURES = (
    ("failure_rate",),
    ("training", "failure_rate"),
    ("failures_before_first_success",),
    ("failures_after_first_success",),
    *((_MILESTONES, name, "failures") for name in TITLES),
)
"""Paths of the figures that count failures."""

Column = Callable[[tuple[str, ...]], Sequence[float | None]]
"""From a path to the values of all seeds."""


def told(domain: Domain, quantities: Iterable[Quantity], column: Column) -> list[Quantity]:
    """Those with a value for some seed.

    Figures of failures are not told where nothing has failed, unless the domain declares that it
    can; nor in older summaries, which declare nothing, where success is not defined.
    """
    of_success = (("success_rate",), ("failures_before_first_success",))
    defined = domain.survival is not None or any(
        v is not None for path in of_success for v in column(path)
    )
    failed = any(any(column(path)) for path in FAILURES)
    can_fail = failed or (domain.can_fail and defined)
    return [
        quantity
        for quantity in quantities
        if any(v is not None for v in column(quantity.path))
        and (can_fail or quantity.path not in FAILURES)
    ]


def told_of(
    domain: Domain, summary: Mapping[str, Any], quantities: Iterable[Quantity]
) -> list[Quantity]:
    """``told``, of one ``summary.json``."""

    def column(path: tuple[str, ...]) -> Sequence[float | None]:
        found: Any = summary
        for key in path:
            found = found.get(key, {})
        return found.get("per_seed", ())

    return told(domain, quantities, column)


def quantities(section: Section) -> list[Quantity]:
    """Those that some learner of the section has."""

    def column(path: tuple[str, ...]) -> Sequence[float | None]:
        return [value for group in section.groups for value in group.per_seed(*path)]

    return told(section.about, every(section.about), column)


def never_there(group: Group, place: str = SUCCESS) -> list[bool]:
    """Of each seed of a group, whether it never succeeded, or never was at a milestone."""
    keys = ("never_succeeded",) if place == SUCCESS else (_MILESTONES, place, "never")
    return [seat.seed in _found(seat.run.summary, keys) for seat in group.places]


def _found(summary: Mapping[str, Any], keys: Sequence[str]) -> Any:
    node: Any = summary
    for key in keys:
        node = node.get(key, {})
    return node


def sample(quantity: Quantity, group: Group) -> Sample | None:
    """Its values in a group; None without any."""
    if quantity.learning and not group.learns:
        return None
    marks = never_there(group, quantity.until or quantity.after or SUCCESS)
    pairs = [
        (value, never and bool(quantity.until))
        for value, never in zip(group.per_seed(*quantity.path), marks, strict=True)
        if value is not None and not (never and quantity.after)
    ]
    return Sample.of([v for v, _ in pairs], [mark for _, mark in pairs]) if pairs else None


def succeeded(group: Group) -> Proportion | None:
    """Seeds that succeeded at all; None where that is not known, or the method does not learn."""
    if not group.learns or not all("never_succeeded" in run.summary for run in group.runs):
        return None
    marks = never_there(group)
    return Proportion(marks.count(False), len(marks))


def zero_failures(group: Group) -> Proportion | None:
    """Seeds that succeeded, and had not failed before: ``zero_failure_rate``.

    One whose budget ended before it failed or succeeded does not count.
    """
    if succeeded(group) is None:
        return None
    failures = group.per_seed("failures_before_first_success")
    pairs = list(zip(failures, never_there(group), strict=True))
    return Proportion(sum(f == 0 and not never for f, never in pairs), len(pairs))
