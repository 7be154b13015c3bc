"""Milestones of histories made by hand."""

from __future__ import annotations

from edtorch.report.domain import Domain
from edtorch.report.milestones import milestone_figures
from sims.base import DEFAULT_WORDS
from sims.bicycle.bicycle import PATH_LENGTH, WORDS
from tests.run.test_milestones import FELL, LATE, RODE, at

BICYCLE = Domain("bicycle", WORDS, (PATH_LENGTH,), survival=True)


def test_the_first_checkpoint_that_is_one_and_what_the_others_paid() -> None:
    history = [
        [at(10, FELL, RODE), at(20, LATE, RODE), at(30, FELL, RODE), at(40, RODE, RODE)],
        [at(10, FELL), at(50, LATE)],
        [at(10, FELL), at(60, FELL)],
    ]
    found = milestone_figures(history, [4, 5, 6], BICYCLE)
    assert found["stable"]["seconds"]["per_seed"] == [20, 50, 60]
    assert found["stable"]["failures"]["per_seed"] == [10, 25, 30]
    assert found["stable"]["falls"] == found["stable"]["failures"]
    assert found["stable"]["never"] == [6]
    assert found["goal"]["seconds"]["per_seed"] == [40, 50, 60]
    assert found["goal"]["never"] == [5, 6]
    assert found["goal"]["cpu_s"]["median"] == 0.5


def test_where_only_the_time_limit_succeeds_there_is_no_goal() -> None:
    lasting = Domain("linear", DEFAULT_WORDS, (), survival=True)
    assert milestone_figures([[at(10, LATE)]], [0], lasting).keys() == {"stable"}
    # Whatever is declared, what has been reached is reported.
    assert milestone_figures([[at(10, RODE)]], [0], lasting).keys() == {"stable", "goal"}
