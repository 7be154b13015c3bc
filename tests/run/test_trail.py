"""The ring of recent states: what is there after any number of ticks, and after a break."""

from __future__ import annotations

import pytest
import torch

from edtorch.run.trail import Trail


def _trail(capacity: int = 5) -> Trail:
    return Trail(torch.zeros(2, 1), stride=1, capacity=capacity)


def _add(trail: Trail, ticks: range) -> None:
    """State t of learner 0 in tick t, 100 + t of learner 1, which is active in even ones."""
    states = torch.tensor([[float(t), 100.0 + t] for t in ticks]).reshape(-1, 2, 1)
    active = torch.tensor([[True, t % 2 == 0] for t in ticks], dtype=torch.bool).reshape(-1, 2)
    trail.extend(states, active)


@pytest.mark.parametrize("ticks", [0, 3, 5, 6, 17])
def test_the_last_states_are_there(ticks: int) -> None:
    trail = _trail()
    _add(trail, range(ticks))
    assert trail.position(0) == ticks
    kept = trail.states(0, 0, ticks).flatten().tolist()
    assert kept == [float(t) for t in range(ticks)][-5:]
    even = [100.0 + t for t in range(0, ticks, 2)]
    assert trail.states(1, 0, len(even)).flatten().tolist() == even[-5:]


@pytest.mark.parametrize("ticks", [0, 3, 5, 6, 17])
def test_it_goes_on_from_its_state(ticks: int) -> None:
    whole, first, second = _trail(), _trail(), _trail()
    _add(whole, range(ticks + 4))
    _add(first, range(ticks))
    second.restore(first.state())
    _add(second, range(ticks, ticks + 4))
    for row in (0, 1):
        last = whole.position(row)
        assert second.position(row) == last
        assert torch.equal(second.states(row, 0, last), whole.states(row, 0, last))


def test_the_state_of_another_one_is_refused() -> None:
    trail = _trail(9)
    _add(trail, range(9))
    with pytest.raises(ValueError, match=r"trail: has the shape \[9, 2, 1\], expected \[5, 2, 1\]"):
        _trail().restore(trail.state())
