"""Milestones in ``summary.json``: what was paid before them (``edtorch.run.milestones``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from edtorch.report.domain import Domain
from edtorch.report.statistics import Spread, aliases
from edtorch.run.milestones import MILESTONES, Checkpoint

PAID = ("seconds", "episodes", "failures", "cpu_s")


def milestone_figures(
    history: Sequence[Sequence[Checkpoint]], seeds: Sequence[int], domain: Domain
) -> dict[str, Any]:
    """Of each milestone what each seed had paid there, and ``never``: the
    seeds that did not get there, for which it is what they had paid in the end.  Of the goal
    nothing where the domain has none.

    history: the checkpoints of each seed, in order, at least one each.
    """
    found: dict[str, Any] = {}
    for name, told in MILESTONES.items():
        first = [next((c for c in own if getattr(c, told)), None) for own in history]
        if name == "goal" and not (domain.has_goal or any(first)):
            continue
        at = [c or own[-1] for c, own in zip(first, history, strict=True)]
        paid = {key: Spread([getattr(c, key) for c in at]).as_json() for key in PAID}
        measured = {
            m.name: Spread([c and c.measures.get(m.name, math.nan) for c in first]).as_json()
            for m in domain.measures
            if m.successes
        }
        never = [seed for seed, c in zip(seeds, first, strict=True) if c is None]
        found[name] = {**paid, **aliases(paid, domain.words), **measured, "never": never}
    return found


AT_CHECKPOINTS = (*PAID, "failure_rate", "goal_rate")


def checkpoint_figures(
    history: Sequence[Sequence[Checkpoint]], domain: Domain
) -> list[dict[str, Any]]:
    """The k-th of each seed beside each other, null where there is none."""
    found: list[dict[str, Any]] = []
    for k in range(max(map(len, history))):
        figures = {
            name: Spread(
                [getattr(own[k], name) if k < len(own) else None for own in history]
            ).as_json()
            for name in AT_CHECKPOINTS
        }
        found.append(figures | aliases(figures, domain.words))
    return found
