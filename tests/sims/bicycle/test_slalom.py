"""The slalom: where its gates are, what is seen of them, when it ends."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from sims.base import Fallible, Outcome
from sims.bicycle.slalom import Slalom

EAST = -math.pi / 2


def at(sim: Slalom, x: float, y: float, gate: float = 0, passed: float = 0) -> Tensor:
    """Upright, heading along the course, the front tyre at (x, y)."""
    bicycle = [0, 0, 0, 0, 0, EAST, x, y, x - 1.11, y]
    return torch.tensor([*bicycle, gate, passed, 0], dtype=torch.float64)


def onward(sim: Slalom, state: Tensor) -> Tensor:
    calm = torch.full((*state.shape[:-1], 1), 0.5).double()
    return sim.step(state, torch.zeros(*state.shape[:-1], 2).double(), calm)


def angle(sim: Slalom, state: Tensor) -> float:
    return float(sim.observe(state)[4])


def test_gates_are_alternately_left_and_right() -> None:
    sim = Slalom()
    for gate in range(10):
        x, y = 40.0 * (gate + 1), 5.0 if gate % 2 == 0 else -5.0
        seen = angle(sim, at(sim, x - 20, 1.0, gate))
        assert seen == pytest.approx(math.atan2(y - 1.0, 20), abs=1e-12)
    # After the last gate, still to it.
    assert angle(sim, at(sim, 410, 0.0, 10)) == pytest.approx(math.atan2(-5, -10), abs=1e-12)


def test_gates_are_passed_between_their_posts() -> None:
    sim = Slalom(look_ahead=0.0)
    for y, passed in ((5.0, 1), (3.01, 1), (6.99, 1), (2.99, 0), (7.01, 0), (-5.0, 0)):
        before = onward(sim, at(sim, 39.96, y))
        assert before[10:].tolist() == [0, 0, 0] and bool(sim.stepped(before))
        after = onward(sim, before)
        assert after[10:].tolist() == [1, passed, 1] and not bool(sim.stepped(after))
        later = onward(sim, after)
        assert later[10:].tolist() == [1, passed, 0] and bool(sim.stepped(later))
    assert isinstance(sim, Fallible)
    left, right = angle(sim, at(sim, 39.9, 5.0)), angle(sim, at(sim, 40.1, 5.0, 1))
    assert left == pytest.approx(0) and right < -0.2


def test_a_gate_that_is_near_is_not_steered_for_any_more() -> None:
    sim = Slalom(look_ahead=6.0)
    state = onward(sim, at(sim, 33.96, 4.0))
    assert angle(sim, state) == pytest.approx(math.atan2(1.0, 40 - float(state[6])), abs=1e-3)
    assert bool(sim.stepped(state))
    state = onward(sim, state)
    # Six metres before its line; it is not reached yet, and counts when it is.
    assert angle(sim, state) == pytest.approx(math.atan2(-9.0, 80 - float(state[6])), abs=1e-3)
    assert state[10:12].tolist() == [0, 0] and not bool(sim.stepped(state))
    near = onward(sim, at(sim, 39.99, 4.0))
    assert near[10:12].tolist() == [1, 1] and bool(sim.stepped(near))
    last = onward(sim, at(sim, 396, -5.0, 9, 9))
    assert angle(sim, last) == pytest.approx(0.0, abs=1e-3) and bool(sim.stepped(last))


def test_it_ends_with_the_last_gate() -> None:
    sim = Slalom()
    states = torch.stack(
        [
            at(sim, 300, 0, 9, 9),
            at(sim, 400, -5, 10, 10),
            at(sim, 400, -5, 10, 9),
            at(sim, 400, 5, 10, 0),
            at(sim, 400, -5, 10, 10),
        ]
    )
    states[4, 2] = 0.3
    wanted = ["RUNNING", "SUCCEEDED", "TIMED_OUT", "TIMED_OUT", "FAILED"]
    assert [Outcome(value).name for value in sim.outcome(states).tolist()] == wanted
    measures = sim.measures(states, states, torch.full((5,), 150.0).double())
    assert measures["gates_passed"].tolist() == [9, 10, 9, 0, 10]
    assert measures["gates_missed"].tolist() == [0, 0, 1, 10, 0]
    assert measures["goal_time_s"].isnan().tolist() == [True, False, True, True, True]
    assert measures["path_length_m"].tolist() == pytest.approx([150 * 10 / 3.6] * 5)


def test_starts_point_along_the_course() -> None:
    sim = Slalom()
    uniforms = torch.rand(1000, 1, generator=torch.Generator().manual_seed(0)).double()
    start = sim.initial(uniforms)
    assert float((start[:, 5] - EAST).abs().max()) <= 0.2
    assert torch.equal(start[:, 10:], torch.zeros(1000, 3).double())
    ridden = start.clone()
    ridden[:, 10:] = 3.0
    mask = torch.arange(1000) % 2 == 0
    new = sim.restart(ridden, mask, uniforms)
    assert torch.equal(new[mask], start[mask]) and torch.equal(new[~mask], ridden[~mask])


@pytest.mark.oracle
def test_the_regulator_that_knows_the_bicycle_rides_it() -> None:
    sim = Slalom(gates=2)
    control, generator = sim.baselines()["lqr"], torch.Generator().manual_seed(0)
    state = sim.initial(torch.rand(4, 1, generator=generator, dtype=torch.float64))
    low, high = torch.tensor([-2.0, -0.02]).double(), torch.tensor([2.0, 0.02]).double()
    for _ in range(3400):
        action = control(state).maximum(low).minimum(high)
        moved = sim.step(state, action, torch.rand(4, 1, generator=generator).double())
        state = torch.where((sim.outcome(state) == 0)[:, None], moved, state)
    assert sim.outcome(state).tolist() == [Outcome.SUCCEEDED] * 4


def test_pictures_show_the_gates() -> None:
    sim = Slalom()
    near, far = at(sim, 36, 4.0)[None], at(sim, 20, 0.0)[None]
    pictures = [sim.frame(trail) for trail in (near, far, at(sim, 36, 4.0, 1, 1)[None])]
    assert all(p.shape == (270, 480, 3) and p.dtype == np.uint8 for p in pictures)
    assert not np.array_equal(pictures[0], pictures[2])
    wide = Slalom(gate_width=8.0)
    assert not np.array_equal(wide.frame(near), pictures[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gates": 0}, "gates=0: expected a whole number, 1 or more"),
        ({"gates": 2.5}, "gates=2.5: expected a whole number"),
        ({"gate_width": 0.0}, "gate_width=0.0: expected a finite number above 0"),
        ({"gate_spacing": 1.0}, "gate_spacing=1.0: expected a finite number above 2"),
        ({"gate_offset": math.nan}, "gate_offset=nan: expected a finite number"),
        ({"goal_radius": 2.0}, "goal_radius=2.0: expected 10.0, a course has gates"),
        ({"noise": -1.0}, "noise=-1.0: expected"),
    ],
)
def test_refuses_impossible_courses(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        Slalom(**arguments)
    assert message in str(refusal.value)
