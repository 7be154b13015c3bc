"""Late readings: each with the action that led to it, and the way from then to now."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.learner.delay import Delay
from tests.systems import f64


def test_an_action_comes_back_when_its_reading_does() -> None:
    delay = Delay(2)
    memory = delay.initial(torch.zeros(1, 1, dtype=torch.float64))
    came, there = [], []
    for tick in range(1, 6):
        action, known, memory = delay.push(memory, f64([[float(tick)]]))
        came.append(action.item())
        there.append(known.item())
    assert there == [False, False, True, True, True]
    assert came[2:] == [1.0, 2.0, 3.0]


def test_without_delay_an_action_is_its_own() -> None:
    delay, action = Delay(0), f64([[3.0, 4.0]])
    found, there, memory = delay.push(delay.initial(action), action)
    assert torch.equal(found, action)
    assert bool(there.all())
    state = f64([[1.0]])
    assert torch.equal(delay.ahead(memory, state, lambda s, a: s + 1), state)


def test_the_way_to_now_takes_the_actions_under_way_and_no_others() -> None:
    delay = Delay(3)
    memory = delay.initial(torch.zeros(1, 1, dtype=torch.float64))

    def move(state: Tensor, action: Tensor) -> Tensor:
        return 10 * state + action

    start, ways = f64([[7.0]]), []
    for tick in range(1, 5):
        ways.append(delay.ahead(memory, start, move).item())
        memory = delay.push(memory, f64([[float(tick)]]))[2]
    assert ways == [7.0, 71.0, 712.0, 7123.0]
    assert delay.ahead(memory, start, move).item() == 7234.0


def test_refuses_readings_from_the_future() -> None:
    with pytest.raises(ValueError, match="delay=-1: expected a whole number of ticks"):
        Delay(-1)
