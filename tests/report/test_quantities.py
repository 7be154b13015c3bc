"""Which figures a report tells of a domain."""

from __future__ import annotations

from typing import Any

import pytest

from edtorch.report.domain import Domain
from edtorch.report.quantities import FAILURES, every, told_of


def _summary(failures: float) -> dict[str, Any]:
    own = {"per_seed": [0.0]}
    return {
        "failure_rate": own,
        "success_rate": own,
        "failures_before_first_success": {"per_seed": [failures]},
        "seconds_before_first_success": own,
        "training": {"failure_rate": own},
    }


@pytest.mark.parametrize(
    ("declared", "failures", "told"), [(True, 0, True), (False, 0, False), (False, 2, True)]
)
def test_failures_are_told_where_they_are_declared_or_seen(
    declared: bool, failures: float, told: bool
) -> None:
    domain = Domain("reacher", survival=False, can_fail=declared)
    found = {q.path for q in told_of(domain, _summary(failures), every(domain))}
    assert bool(found & set(FAILURES)) is told
    assert ("success_rate",) in found and ("seconds_before_first_success",) in found
