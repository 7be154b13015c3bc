"""Milestones of histories made by hand."""

from __future__ import annotations

from typing import Any

from edtorch.report.domain import Domain
from edtorch.report.milestones import Checkpoint, checkpoint, milestones
from edtorch.run.episodes import Episode
from sims.base import DEFAULT_WORDS, Outcome
from sims.bicycle.bicycle import PATH_LENGTH, WORDS

BICYCLE = Domain("bicycle", WORDS, (PATH_LENGTH,), survival=True)
_PAID: dict[str, Any] = {"seconds": 1, "failures": 1, "episodes": 1, "cpu_s": 1.0}
FELL, RODE, LATE = Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT


def _tried(*outcomes: Outcome, lengths: tuple[float, ...] = ()) -> list[Episode]:
    measures = [{"path_length_m": length} for length in lengths] or [{}] * len(outcomes)
    pairs = zip(outcomes, measures, strict=True)
    return [Episode(0, k, 0, 1, o, m) for k, (o, m) in enumerate(pairs)]


def _at(seconds: float, *outcomes: Outcome) -> Checkpoint:
    return checkpoint(
        _tried(*outcomes),
        [],
        seconds=seconds,
        failures=round(seconds / 2),
        episodes=7,
        cpu_s=seconds / 100,
    )


def test_a_checkpoint_counts_its_episodes() -> None:
    lengths = (1000.0, 1010.0, 400.0, 5.0)
    fresh = _tried(RODE, RODE, LATE, FELL, lengths=lengths)
    found = checkpoint(fresh, [PATH_LENGTH], seconds=3, failures=1, episodes=2, cpu_s=0.5)
    assert (found.tried, found.failure_rate, found.goal_rate) == (4, 0.25, 0.5)
    assert found.measures == {"path_length_m": 1005.0}
    assert not found.stable and not found.to_the_goal
    assert checkpoint(_tried(LATE), [PATH_LENGTH], **_PAID).measures == {}


def test_stable_is_without_a_fall_and_to_the_goal_is_all_of_them() -> None:
    assert _at(1, LATE, RODE).stable and not _at(1, LATE, RODE).to_the_goal
    assert _at(1, RODE, RODE).stable and _at(1, RODE, RODE).to_the_goal


def test_the_first_checkpoint_that_is_one_and_what_the_others_paid() -> None:
    history = [
        [_at(10, FELL, RODE), _at(20, LATE, RODE), _at(30, FELL, RODE), _at(40, RODE, RODE)],
        [_at(10, FELL), _at(50, LATE)],
        [_at(10, FELL), _at(60, FELL)],
    ]
    found = milestones(history, [4, 5, 6], BICYCLE)
    assert found["stable"]["seconds"]["per_seed"] == [20, 50, 60]
    assert found["stable"]["failures"]["per_seed"] == [10, 25, 30]
    assert found["stable"]["falls"] == found["stable"]["failures"]
    assert found["stable"]["never"] == [6]
    assert found["goal"]["seconds"]["per_seed"] == [40, 50, 60]
    assert found["goal"]["never"] == [5, 6]
    assert found["goal"]["cpu_s"]["median"] == 0.5


def test_where_only_the_time_limit_succeeds_there_is_no_goal() -> None:
    lasting = Domain("linear", DEFAULT_WORDS, (), survival=True)
    assert milestones([[_at(10, LATE)]], [0], lasting).keys() == {"stable"}
    # Whatever is declared, what has been reached is reported.
    assert milestones([[_at(10, RODE)]], [0], lasting).keys() == {"stable", "goal"}
