"""Summaries from before domains had words and measures of their own, in the keys of today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from edtorch.report.domain import Domain, undeclared
from edtorch.report.statistics import names_by
from sims.base import Words

WORDS = Words("fall", "falls", "ride", "rides", "fell", "rode")
"""The keys of every domain were made of these."""
FINAL, MINUTES = "final", "minutes"


def old_domain(name: str, summary: Mapping[str, Any]) -> Domain:
    """All that such a summary tells of a domain that is not known."""
    final = summary.get(FINAL)
    names = final.keys() - {MINUTES, "success_rate"} if isinstance(final, Mapping) else ()
    return Domain(name, Words(), undeclared(sorted(names)))


def modern(summary: Mapping[str, Any], domain: Domain) -> dict[str, Any]:
    """``summary`` with today's keys added.

    Those of the first success only where the time limit is one: it counted as one everywhere.
    Where there are figures of a final evaluation by the sim's own measures, they stand for those
    that were made for the bicycle.
    """
    names = names_by(WORDS)
    if domain.survival is False:
        names = {"failure_rate": names["failure_rate"]}
    found = _renamed(summary, names)
    final = summary.get(FINAL)
    if isinstance(final, Mapping):
        own = {key: value for key, value in final.items() if key != MINUTES}
        found |= _renamed(own, names_by(domain.words))
    if isinstance(evaluations := summary.get("evaluations"), list):
        found["evaluations"] = [
            _renamed(own, names_by(domain.words)) if isinstance(own, Mapping) else own
            for own in evaluations
        ]
    milestones = summary.get("milestones")
    if isinstance(milestones, Mapping):
        found["milestones"] = {
            name: _renamed(own, names) if isinstance(own, Mapping) else own
            for name, own in milestones.items()
        }
    return found


def _renamed(figures: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    added = {new: figures[old] for new, old in names.items() if old in figures}
    # The file's own keys first: an error then names one of those.
    return {**figures, **{key: value for key, value in added.items() if key not in figures}}
