"""What a report tells of a group of learners: which figures, with which names and digits."""

from __future__ import annotations

from dataclasses import dataclass

from edtorch.report.groups import Group, Section
from edtorch.report.proportions import Proportion
from edtorch.report.runs import LEARNING
from edtorch.report.samples import Sample


@dataclass(frozen=True)
class Quantity:
    """A figure with one value per seed.

    path: where it stands in ``summary.json``; brief: its label where there is little room; digits:
    after the point; more_is_better: how a learner improves on another; until_ride: it counts up to
    the first ride, and is censored for a learner that never rode; after_ride: such a learner has
    none; milestone: in place of the first ride for these two.
    """

    path: tuple[str, ...]
    label: str
    brief: str
    digits: int
    more_is_better: bool = False
    until_ride: bool = False
    after_ride: bool = False
    milestone: str = ""

    @property
    def name(self) -> str:
        """In ``report.json``."""
        return ".".join(self.path)


FALLS, SECONDS = (
    Quantity((LEARNING[0],), "falls before the first ride", "falls before", 1, until_ride=True),
    Quantity((LEARNING[1],), "seconds before the first ride", "seconds before", 1, until_ride=True),
)
FALLS_AFTER = Quantity(
    ("falls_after_first_ride",), "falls after the first ride", "falls after", 1, after_ride=True
)
EVALUATION = (
    Quantity(
        ("goal_rate",),
        "evaluation: share that reaches the goal",
        "goal rate",
        4,
        more_is_better=True,
    ),
    Quantity(("fall_rate",), "evaluation: share that falls", "fall rate", 4),
    Quantity(("goal_time_s",), "evaluation: time to the goal, s", "goal time, s", 1),
    Quantity(
        ("goal_time_over_shortest",),
        "evaluation: time over the shortest possible",
        "over shortest",
        4,
    ),
    Quantity(("path_length_m",), "evaluation: length of path, m", "path, m", 1),
    Quantity(("episode_s",), "evaluation: length of episode, s", "episode, s", 1),
)
FINAL = "final"
"""Where the figures of a family of tasks stand, at the end of learning."""
MINUTES = "minutes"


MILESTONES = "milestones"
"""Where they stand in ``summary.json``."""
TITLES = {"stable": "stable riding", "goal": "the goal"}
"""Of the milestones, as in "what was paid to ..."."""


def _milestone(name: str) -> tuple[Quantity, ...]:
    to = TITLES[name]

    def paid(key: str, what: str, digits: int) -> Quantity:
        place = (MILESTONES, name, key)
        return Quantity(place, f"{what} to {to}", what, digits, until_ride=True, milestone=name)

    path = Quantity(
        (MILESTONES, name, "path_length_m"),
        f"path length of the first policy at {to}, m",
        "path, m",
        0,
        after_ride=True,
        milestone=name,
    )
    return (
        paid("falls", "falls", 1),
        paid("seconds", "simulated seconds", 1),
        paid("cpu_s", "CPU seconds", 2),
        path,
    )


TO_STABLE = _milestone("stable")[:3]
TO_GOAL = _milestone("goal")
"""What was paid before a policy first rode in all its fresh episodes, and first to the goal in all
of them; and how long its path then was."""


def quantities(section: Section) -> list[Quantity]:
    """Those that some learner of the section has."""
    finals: dict[str, None] = {}
    for group in section.groups:
        for run in group.runs:
            finals |= dict.fromkeys(run.summary.get(FINAL, {}))
    finals.pop(MINUTES, None)
    # Those of a family of tasks tell the same as the plain evaluation, and more.
    after = [_final(key) for key in finals] if finals else list(EVALUATION)
    every = [FALLS, SECONDS, FALLS_AFTER, *after, *TO_STABLE, *TO_GOAL]
    return [
        quantity
        for quantity in every
        if any(v is not None for group in section.groups for v in group.per_seed(*quantity.path))
    ]


def _final(key: str) -> Quantity:
    brief = key.replace("_", " ")
    return Quantity(
        (FINAL, key), f"evaluation: {brief}", brief, 4, more_is_better=key.endswith("success_rate")
    )


def never_rode(group: Group) -> list[bool]:
    """Of each seed of a group."""
    return [place.seed in place.run.summary["never_rode"] for place in group.places]


def _never(quantity: Quantity, group: Group) -> list[bool]:
    """Of each seed, whether it never was where the quantity counts to."""
    if not quantity.milestone:
        return never_rode(group)
    return [
        place.seed
        in place.run.summary.get(MILESTONES, {}).get(quantity.milestone, {}).get("never", ())
        for place in group.places
    ]


def sample(quantity: Quantity, group: Group) -> Sample | None:
    """Its values in a group; None without any."""
    marks = _never(quantity, group)
    pairs = [
        (value, never and quantity.until_ride)
        for value, never in zip(group.per_seed(*quantity.path), marks, strict=True)
        if value is not None and not (never and quantity.after_ride)
    ]
    return Sample.of([v for v, _ in pairs], [mark for _, mark in pairs]) if pairs else None


def rode(group: Group) -> Proportion:
    """Seeds that rode at all."""
    marks = never_rode(group)
    return Proportion(marks.count(False), len(marks))


def zero_falls(group: Group) -> Proportion:
    """Seeds that rode, and did not fall before: ``zero_fall_rate``.

    One whose budget ended before it fell or rode is none of them.
    """
    falls = group.per_seed(*FALLS.path)
    pairs = list(zip(falls, never_rode(group), strict=True))
    return Proportion(sum(f == 0 and not never for f, never in pairs), len(pairs))
