"""Milestones of histories made by hand."""

from __future__ import annotations

import math

from edtorch.report.milestones import Checkpoint, checkpoint, milestones
from edtorch.run.episodes import Episode
from sims.base import Outcome

FELL, RODE, LATE = Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT


def _tried(*outcomes: Outcome, lengths: tuple[float, ...] = ()) -> list[Episode]:
    measures = [{"path_length_m": length} for length in lengths] or [{}] * len(outcomes)
    pairs = zip(outcomes, measures, strict=True)
    return [Episode(0, k, 0, 1, o, m) for k, (o, m) in enumerate(pairs)]


def _at(seconds: float, *outcomes: Outcome) -> Checkpoint:
    return checkpoint(
        _tried(*outcomes), seconds=seconds, falls=round(seconds / 2), paid=7, cpu_s=seconds / 100
    )


def test_a_checkpoint_counts_its_episodes() -> None:
    lengths = (1000.0, 1010.0, 400.0, 5.0)
    found = checkpoint(
        _tried(RODE, RODE, LATE, FELL, lengths=lengths), seconds=3, falls=1, paid=2, cpu_s=0.5
    )
    assert (found.tried, found.fall_rate, found.goal_rate) == (4, 0.25, 0.5)
    assert found.path_length_m == 1005.0
    assert not found.stable and not found.to_the_goal
    assert math.isnan(_at(1, LATE).path_length_m)


def test_stable_is_without_a_fall_and_to_the_goal_is_all_of_them() -> None:
    assert _at(1, LATE, RODE).stable and not _at(1, LATE, RODE).to_the_goal
    assert _at(1, RODE, RODE).stable and _at(1, RODE, RODE).to_the_goal


def test_the_first_checkpoint_that_is_one_and_what_the_others_paid() -> None:
    history = [
        [_at(10, FELL, RODE), _at(20, LATE, RODE), _at(30, FELL, RODE), _at(40, RODE, RODE)],
        [_at(10, FELL), _at(50, LATE)],
        [_at(10, FELL), _at(60, FELL)],
    ]
    found = milestones(history, [4, 5, 6])
    assert found["stable"]["seconds"]["per_seed"] == [20, 50, 60]
    assert found["stable"]["falls"]["per_seed"] == [10, 25, 30]
    assert found["stable"]["never"] == [6]
    assert found["goal"]["seconds"]["per_seed"] == [40, 50, 60]
    assert found["goal"]["never"] == [5, 6]
    assert found["goal"]["cpu_s"]["median"] == 0.5
