"""What was paid at milestones, of episodes made by hand."""

from __future__ import annotations

from typing import Any

from edtorch.run.episodes import Episode
from edtorch.run.milestones import Checkpoint, FirstSuccess, checkpoint, first_success
from sims.base import Outcome
from sims.bicycle.bicycle import PATH_LENGTH

FELL, RODE, LATE = Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT
_PAID: dict[str, Any] = {"seconds": 1, "failures": 1, "episodes": 1, "cpu_s": 1.0}


def _episodes(*ends: tuple[float, Outcome], survival: bool = True) -> list[Episode]:
    """One learner's episodes, one after the other: (seconds, outcome)."""
    episodes, start = [], 0.0
    success = {FELL: False, RODE: True, LATE: survival}
    for number, (seconds, outcome) in enumerate(ends):
        episodes.append(Episode(0, number, start, seconds, outcome, {}, success=success[outcome]))
        start += seconds
    return episodes


class TestFirstSuccess:
    def test_failures_and_seconds_until_it_starts(self) -> None:
        episodes = _episodes((2, FELL), (3, FELL), (400, RODE), (5, FELL), (300, RODE))
        assert first_success(episodes, 710) == FirstSuccess(True, 2, 5, 1)

    def test_the_time_limit_counts_where_it_is_a_success(self) -> None:
        ends = ((2, FELL), (1000, LATE))
        assert first_success(_episodes(*ends), 1002) == FirstSuccess(True, 1, 2, 0)
        late = _episodes(*ends, survival=False)
        assert first_success(late, 1002) == FirstSuccess(False, 1, 1002, 0)

    def test_at_once(self) -> None:
        episodes = _episodes((400, RODE), (2, FELL))
        assert first_success(episodes, 402) == FirstSuccess(True, 0, 0, 1)

    def test_never_costs_what_it_has_cost_so_far(self) -> None:
        """The seconds of the unfinished episode count."""
        episodes = _episodes((2, FELL), (3, FELL))
        assert first_success(episodes, 60) == FirstSuccess(False, 2, 60, 0)

    def test_no_episode(self) -> None:
        assert first_success([], 7) == FirstSuccess(False, 0, 7, 0)


def _tried(*outcomes: Outcome, lengths: tuple[float, ...] = ()) -> list[Episode]:
    measures = [{"path_length_m": length} for length in lengths] or [{}] * len(outcomes)
    pairs = zip(outcomes, measures, strict=True)
    return [Episode(0, k, 0, 1, o, m) for k, (o, m) in enumerate(pairs)]


def at(seconds: float, *outcomes: Outcome) -> Checkpoint:
    """A checkpoint of these fresh episodes, paid in proportion to the seconds."""
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
    assert at(1, LATE, RODE).stable and not at(1, LATE, RODE).to_the_goal
    assert at(1, RODE, RODE).stable and at(1, RODE, RODE).to_the_goal
