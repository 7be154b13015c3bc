"""Episodes as tensors and back."""

import math

import pytest
import torch

from edtorch.run.episodes import Episode, episodes_of, episodes_state
from sims.base import Outcome


def _episode(
    row: int, number: int, outcome: Outcome, *rest: float, success: bool | None
) -> Episode:
    start, seconds, earned, first, second = rest
    measures = {"first_m": first, "second": second}
    return Episode(
        row, number, start, seconds, outcome, measures, total_reward=earned, success=success
    )


EPISODES = [
    _episode(0, 0, Outcome.FAILED, 0.0, 0.1 + 0.2, -math.inf, 1 / 3, -0.0, success=False),
    _episode(3, 1, Outcome.TIMED_OUT, 1e9 + 0.01, 5e-324, 0.0, math.inf, 2.0, success=None),
    _episode(1, 7, Outcome.SUCCEEDED, 2.5, 1.0, math.pi, 0.0, 1e-9, success=True),
]


@pytest.mark.parametrize("count", [0, 1, 3])
def test_what_was_an_episode_is_the_same_again(count: int) -> None:
    state = episodes_state(EPISODES[:count])
    assert all(values.shape == (count,) for name, values in state.items() if name != "measures")
    back = episodes_of(state)
    assert back == EPISODES[:count]
    assert repr(back) == repr(EPISODES[:count])  # signs of zeros, and kinds of numbers


def test_what_is_not_known_is_not_known_afterwards() -> None:
    episode = Episode(0, 0, 0.0, 1.0, Outcome.FAILED, {"a_m": math.nan})
    state = episodes_state([episode])
    assert state["success"].dtype == state["row"].dtype == torch.int64
    (back,) = episodes_of(state)
    assert math.isnan(back.total_reward) and math.isnan(back.measures["a_m"])
    assert back.success is None
