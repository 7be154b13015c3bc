"""The figures of a run, on episodes made by hand."""

from __future__ import annotations

import math

import pytest

from edtorch.report.statistics import (
    FirstRide,
    Spread,
    by_row,
    evaluation_figures,
    first_ride,
    learning_figures,
)
from edtorch.run.episodes import Episode
from sims.base import Outcome

FELL, RODE, LATE = Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT


def _episodes(*ends: tuple[float, Outcome], row: int = 0, **measures: float) -> list[Episode]:
    """One learner's episodes, one after the other: (seconds, outcome)."""
    episodes, start = [], 0.0
    for number, (seconds, outcome) in enumerate(ends):
        episodes.append(Episode(row, number, start, seconds, outcome, measures))
        start += seconds
    return episodes


class TestFirstRide:
    def test_falls_and_seconds_until_it_starts(self) -> None:
        episodes = _episodes((2, FELL), (3, FELL), (400, RODE), (5, FELL), (300, RODE))
        assert first_ride(episodes, 710) == FirstRide(True, 2, 5, 1)

    def test_the_time_limit_without_a_fall_is_a_ride(self) -> None:
        assert first_ride(_episodes((2, FELL), (1000, LATE)), 1002) == FirstRide(True, 1, 2, 0)

    def test_at_once(self) -> None:
        assert first_ride(_episodes((400, RODE), (2, FELL)), 402) == FirstRide(True, 0, 0, 1)

    def test_never_costs_what_it_has_cost_so_far(self) -> None:
        """The seconds of the unfinished episode count."""
        assert first_ride(_episodes((2, FELL), (3, FELL)), 60) == FirstRide(False, 2, 60, 0)

    def test_no_episode(self) -> None:
        assert first_ride([], 7) == FirstRide(False, 0, 7, 0)


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
    figures = learning_figures(mixed, [7, 8], [402.0, 30.0])
    assert figures["falls_before_first_ride"]["per_seed"] == [1, 3]
    assert figures["seconds_before_first_ride"]["per_seed"] == [2, 30.0]
    assert figures["seconds_before_first_ride"]["median"] == 16.0
    assert figures["falls_after_first_ride"]["per_seed"] == [0, 0]
    assert figures["never_rode"] == [8]
    assert figures["zero_fall_rate"] == 0.0
    lucky = learning_figures(_episodes((400, RODE), (2, FELL), row=0), [7, 8], [402.0, 30.0])
    # The second has not fallen, but has not ridden either.
    assert lucky["zero_fall_rate"] == 0.5
    assert by_row(mixed, 2) == [quick, slow]


def test_evaluation_figures() -> None:
    """Medians over the episodes that reached the goal; rates over all of them."""
    good = [
        *_episodes((360, RODE), path_length_m=1000.0, shortest_time_s=356.0),
        *_episodes((380, RODE), path_length_m=1050.0, shortest_time_s=360.0),
        *_episodes((400, RODE), path_length_m=1100.0, shortest_time_s=0.0),
        *_episodes((2, FELL), path_length_m=5.0, shortest_time_s=356.0),
    ]
    bad = _episodes((2, FELL), (1000, LATE), path_length_m=5.0)
    figures = evaluation_figures([good, bad])
    assert figures["goal_rate"]["per_seed"] == [0.75, 0.0]
    assert figures["fall_rate"]["per_seed"] == [0.25, 0.5]
    assert figures["goal_time_s"]["per_seed"] == [380, None]
    assert figures["goal_time_s"]["median"] == 380
    assert figures["path_length_m"]["per_seed"] == [1050.0, None]
    (over, none) = figures["goal_time_over_shortest"]["per_seed"]
    assert over == pytest.approx((360 / 356 + 380 / 360) / 2)
    assert none is None
    assert figures["episode_s"]["per_seed"] == [370, 501]
    assert figures["goal_time_all_s"] == {"median": 380, "p95": 400, "max": 400}
    assert evaluation_figures([[]])["goal_time_all_s"]["median"] is None


def test_evaluation_of_nothing() -> None:
    figures = evaluation_figures([[], []])
    assert figures.pop("goal_time_all_s") == {"median": None, "p95": None, "max": None}
    for figure in figures.values():
        assert figure == {"per_seed": [None, None], "median": None, "min": None, "max": None}
