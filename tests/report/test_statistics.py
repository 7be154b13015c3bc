"""The figures of a run, on episodes made by hand."""

from __future__ import annotations

import math

import pytest

from edtorch.report.statistics import (
    Spread,
    aliases,
    by_row,
    evaluation_figures,
    first_success_figures,
    generic_figures,
    is_defined,
)
from edtorch.run.episodes import Episode
from edtorch.run.milestones import first_success
from sims.base import DEFAULT_WORDS, Measure, Outcome
from sims.bicycle.bicycle import WORDS, Bicycle

FELL, RODE, LATE = Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT
NOTHING = {"per_seed": [None, None], "median": None, "min": None, "max": None}


def _episodes(
    *ends: tuple[float, Outcome],
    row: int = 0,
    returns: float = math.nan,
    survival: bool | None = True,
    **measures: float,
) -> list[Episode]:
    """One learner's episodes, one after the other: (seconds, outcome)."""
    episodes, start = [], 0.0
    late = {FELL: False, RODE: True, LATE: survival}
    for number, (seconds, outcome) in enumerate(ends):
        success = None if survival is None else late[outcome]
        episodes.append(Episode(row, number, start, seconds, outcome, measures, returns, success))
        start += seconds
    return episodes


class TestSpread:
    def test_over_the_seeds_that_have_it(self) -> None:
        spread = Spread([3.0, None, 1.0, math.nan, 10.0])
        assert spread.as_json() == {
            "per_seed": [3.0, None, 1.0, None, 10.0],
            "median": 3.0,
            "min": 1.0,
            "max": 10.0,
        }

    @pytest.mark.parametrize("per_seed", [[], [None, None], [math.nan]])
    def test_none(self, per_seed: list[float | None]) -> None:
        figures = Spread(per_seed).as_json()
        assert (figures["median"], figures["min"], figures["max"]) == (None, None, None)
        assert all(v is None for v in figures["per_seed"])


def test_learning_figures_keep_learners_apart() -> None:
    quick = _episodes((2, FELL), (400, RODE), row=0)
    slow = _episodes((2, FELL), (4, FELL), (6, FELL), row=1)
    mixed = sorted([*quick, *slow], key=lambda e: e.start + e.seconds)
    assert by_row(mixed, 2) == [quick, slow]
    first = [first_success(quick, 402.0), first_success(slow, 30.0)]
    figures = first_success_figures(first, [7, 8])
    assert figures["failures_before_first_success"]["per_seed"] == [1, 3]
    assert figures["seconds_before_first_success"]["per_seed"] == [2, 30.0]
    assert figures["seconds_before_first_success"]["median"] == 16.0
    assert figures["failures_after_first_success"]["per_seed"] == [0, 0]
    assert figures["never_succeeded"] == [8]
    assert figures["zero_failure_rate"] == 0.0
    first = [first_success(_episodes((400, RODE), (2, FELL)), 402.0), first_success([], 30.0)]
    lucky = first_success_figures(first, [7, 8])
    # The second has not failed, but has not succeeded either.
    assert lucky["zero_failure_rate"] == 0.5


def test_rates_and_return_come_first_and_what_is_not_known_is_left_out() -> None:
    good = _episodes((10, LATE), (4, FELL), returns=-2.0)
    bad = _episodes((1, FELL), returns=-8.0, row=1)
    figures = generic_figures([good, bad])
    assert list(figures) == ["failure_rate", "return", "success_rate", "episode_s"]
    assert figures["failure_rate"]["per_seed"] == [0.5, 1]
    assert figures["return"]["per_seed"] == [-2, -8] and figures["return"]["median"] == -5
    assert figures["success_rate"]["per_seed"] == [0.5, 0]
    assert figures["episode_s"]["per_seed"] == [7, 1]
    unjudged = generic_figures([_episodes((10, LATE), survival=None)])
    assert list(unjudged) == ["failure_rate", "episode_s"]


def test_success_is_defined_by_the_domain_or_by_an_episode() -> None:
    unjudged = _episodes((10, LATE), survival=None)
    assert not is_defined([unjudged], None)
    assert is_defined([unjudged], True) and is_defined([], False)
    assert is_defined([unjudged, _episodes((10, LATE))], None)


def test_what_the_sim_measures() -> None:
    """Medians over the episodes that reached the goal; means over all of them."""
    measures = Bicycle().spec.measures
    good = [
        *_episodes((360, RODE), goal_rate=1, goal_time_s=360, path_length_m=1000.0),
        *_episodes((380, RODE), goal_rate=1, goal_time_s=380, path_length_m=1050.0),
        *_episodes((400, RODE), goal_rate=1, goal_time_s=400, path_length_m=1100.0),
        *_episodes((2, FELL), goal_rate=0, goal_time_s=math.nan, path_length_m=5.0),
    ]
    bad = _episodes((2, FELL), (1000, LATE), goal_rate=0, goal_time_s=math.nan, path_length_m=5.0)
    figures = evaluation_figures([good, bad], measures, WORDS)
    assert figures["goal_rate"]["per_seed"] == [0.75, 0.0]
    assert figures["fall_rate"] == figures["failure_rate"]
    assert figures["fall_rate"]["per_seed"] == [0.25, 0.5]
    assert figures["goal_time_s"]["per_seed"] == [380, None]
    assert figures["goal_time_s"]["median"] == 380
    assert figures["path_length_m"]["per_seed"] == [1050.0, None]
    assert figures["episode_s"]["per_seed"] == [370, 501]
    assert figures["goal_time_all_s"] == {"median": 380, "p95": 400, "max": 400}


def test_the_median_beside_the_mean() -> None:
    error = Measure("error_m", "error", "m", "lower", median="error_median_m")
    own = [e for value in (0.1, 0.2, 0.6) for e in _episodes((1, LATE), error_m=value)]
    own += _episodes((1, FELL), error_m=1.1)
    figures = evaluation_figures([own], [error], DEFAULT_WORDS)
    assert figures["error_m"]["per_seed"] == [pytest.approx(0.5)]
    assert figures["error_median_m"]["per_seed"] == [pytest.approx(0.4)]


def test_evaluation_of_nothing() -> None:
    figures = evaluation_figures([[], []], Bicycle().spec.measures, WORDS)
    assert figures.pop("goal_time_all_s") == {"median": None, "p95": None, "max": None}
    assert "return" not in figures and "success_rate" not in figures
    for figure in figures.values():
        assert figure == NOTHING


def test_keys_in_the_words_of_the_domain() -> None:
    figures = first_success_figures([first_success(_episodes((2, FELL)), 4.0)], [3])
    named = aliases(figures, WORDS)
    assert named == {
        "falls_before_first_ride": figures["failures_before_first_success"],
        "seconds_before_first_ride": figures["seconds_before_first_success"],
        "falls_after_first_ride": figures["failures_after_first_success"],
        "zero_fall_rate": 0,
        "never_rode": [3],
    }
    assert figures | aliases(figures, DEFAULT_WORDS) == figures
