"""Trials on the way: who is screened, who runs all fresh episodes, what is kept of them."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from edtorch.app.trials import SCREENING, Paid, Trials
from edtorch.run.episodes import Episode
from sims.base import Outcome
from sims.bicycle.bicycle import PATH_LENGTH
from tests.states import read_back

FELL, RODE, ARRIVED = Outcome.FAILED, Outcome.TIMED_OUT, Outcome.SUCCEEDED


class World:
    """Gives the fresh episodes that it is told to, and remembers for whom."""

    def __init__(self, *outcomes: Sequence[Outcome]) -> None:
        self.outcomes = [list(own) for own in outcomes]
        self.asked: list[tuple[list[int], int]] = []

    def fresh(self, rows: Sequence[int], count: int) -> list[list[Episode]]:
        self.asked.append((list(rows), count))
        return [
            [
                Episode(row, k, 0.0, 3.0, outcome, {"path_length_m": 10.0 + k})
                for k, outcome in enumerate(self.outcomes[row][:count])
            ]
            for row in rows
        ]


def paid(row: int) -> Paid:
    return Paid(seconds=10.0 * row, episodes=row + 1, failures=row, cpu_s=0.5)


def test_a_fall_in_the_screening_is_no_stable_policy_and_costs_no_more() -> None:
    world = World([FELL] * 5, [ARRIVED] * 5, [RODE, RODE, FELL, ARRIVED, ARRIVED])
    trials = Trials(3, 5, world.fresh, [PATH_LENGTH])
    found = trials.run([0, 1, 2], paid)
    assert world.asked == [([0, 1, 2], SCREENING), ([1, 2], 5)]
    assert [found[row].tried for row in range(3)] == [SCREENING, 5, 5]
    assert [found[row].stable for row in range(3)] == [False, True, False]
    assert found[2].failure_rate == pytest.approx(0.2) and found[2].goal_rate == pytest.approx(0.4)
    assert found[1].measures["path_length_m"] == pytest.approx(12.0)
    assert (found[2].seconds, found[2].episodes, found[2].failures) == (20.0, 3, 2)
    assert trials.reached("stable") == trials.reached("goal") == [False, True, False]
    complete = trials.complete()
    assert world.asked[-1] == ([0], 5)
    assert [len(own) for own in complete] == [5, 5, 5]


def test_without_screening_all_are_tried_in_everything() -> None:
    world = World([FELL] + [ARRIVED] * 4)
    found = Trials(1, 5, world.fresh, screening=5).run([0], paid)[0]
    assert (found.tried, found.failure_rate) == (5, pytest.approx(0.2))


def test_who_rode_the_last_time_is_not_screened() -> None:
    world = World([RODE] * 4, [FELL] * 4)
    trials = Trials(2, 4, world.fresh)
    trials.run([0, 1], paid)
    world.asked.clear()
    world.outcomes[0] = [RODE, RODE, RODE, FELL]
    trials.run([0, 1], paid)
    assert world.asked == [([1], SCREENING), ([0], 4)]
    # A milestone stays one, whatever comes after.
    assert [c.stable for c in trials.history[0]] == [True, False]
    assert trials.reached("stable") == [True, False]


def _told(trials: Trials) -> str:
    """In words, in which a return that there is not equals itself."""
    return repr((trials.history, trials.last))


def test_it_goes_on_from_its_state() -> None:
    """Who is screened depends on the trial before; ``complete`` on what was screened only."""
    outcomes = [RODE] * 4, [FELL] * 4
    before, after = World(*outcomes), World(*outcomes)
    trials, resumed = (Trials(2, 4, w.fresh, [PATH_LENGTH]) for w in (before, after))
    trials.run([0, 1], paid)
    resumed.restore(read_back(trials.state()))
    assert _told(resumed) == _told(trials)
    before.asked.clear()
    for each in (trials, resumed):
        each.run([0, 1], paid)
        each.complete()
    assert after.asked == before.asked == [([1], SCREENING), ([0], 4), ([1], 4)]
    assert _told(resumed) == _told(trials)


def test_few_episodes_are_all_run() -> None:
    world = World([RODE], [FELL])
    trials = Trials(2, 1, world.fresh)
    trials.run([0, 1], paid)
    assert world.asked == [([0, 1], 1)]
