"""When the policy is improved."""

from __future__ import annotations

import pytest

from edtorch.learner.schedule import ALWAYS, Schedule


def test_often_at_first_and_seldom_later() -> None:
    schedule = Schedule(first=10, often=20, every=16)
    ticks = [clock for clock in range(1, 100) if schedule.improves(clock)]
    assert ticks == [*range(10, 21), 32, 48, 64, 80, 96]


def test_always_is_always() -> None:
    assert all(ALWAYS.improves(clock) for clock in range(1, 50))


@pytest.mark.parametrize(("name", "value"), [("first", 0), ("often", -1), ("every", 0)])
def test_refuses_ticks_that_are_none(name: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{name}={value}: expected"):
        Schedule(**{name: value})
