"""What all tasks with a tip share: starts, readings, the window, the judgement, pictures."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba.core.config
import numpy as np
import pytest
import torch
from torch import Tensor

from sims.base import JudgesStates, Outcome, Pictured
from sims.conformance import check
from sims.sensing import Sensed
from sims.tasks.cart_double_pendulum import CartDoublePendulum
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from sims.tasks.double_pendulum import DoublePendulum
from sims.tasks.held_tip import HeldTip
from sims.tasks.pendubot import Pendubot
from sims.tasks.pendulum_swing_up import PendulumSwingUp
from sims.tasks.stop_pendulum import StopPendulum

TASKS: dict[str, Callable[..., HeldTip]] = {
    "cart-pole": CartPoleSwingUp,
    "pendulum": PendulumSwingUp,
    "pendubot": Pendubot,
    "double pendulum": DoublePendulum,
    "cart-double-pendulum": CartDoublePendulum,
    "stop pendulum": StopPendulum,
}


def uniform(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def roll_out(sim: HeldTip, actions: Tensor, start: Tensor) -> Tensor:
    """Full states ``[B, T + 1, k]`` under actions ``[B, T, m]``."""
    states = [start]
    for action in actions.unbind(-2):
        states.append(sim.step(states[-1], action, torch.zeros(len(start), 0).double()))
    return torch.stack(states, -2)


@pytest.mark.parametrize("name", TASKS)
def test_conforms(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    check(TASKS[name](), batches=((), (1,), (5,)), steps=2, compiled=False)
    # Not compiled, which takes seconds: numba leaves the functions of numbers as they are.
    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    check(TASKS[name](), batches=((5,),), steps=2)


@pytest.mark.oracle
@pytest.mark.parametrize(
    "name", ["pendulum", pytest.param("cart-double-pendulum", marks=pytest.mark.long)]
)
def test_conforms_compiled(name: str) -> None:
    check(TASKS[name](), batches=((5,),), steps=3)


@pytest.mark.parametrize("name", TASKS)
def test_what_is_told(name: str) -> None:
    spec = TASKS[name]().spec
    for k, quantity in enumerate(spec.state):
        assert quantity.rate_of == (spec.state[k - 1].name if k % 2 else "")
        assert quantity.scale == {"rad/s": 6.0, "m/s": 3.0, "rad": 1.0, "m": 1.0}[quantity.unit]
        assert quantity.period == (2 * math.pi if quantity.unit == "rad" else 0)
    for quantity in spec.action:
        assert quantity.high == -quantity.low == quantity.scale


@pytest.mark.parametrize("name", TASKS)
def test_starts_are_normal_about_hanging(name: str) -> None:
    sim = TASKS[name]()
    n, count = len(sim.spec.state), 20_000
    start = sim.initial(uniform(count, n))
    mean, deviation = (
        torch.tensor(sim.mean, dtype=torch.float64),
        torch.tensor(sim.deviation, dtype=torch.float64),
    )
    scaled = (start[:, :n] - mean) / deviation
    assert float(scaled.mean(0).abs().max()) < 5 / count**0.5
    assert float((torch.cov(scaled.mT) - torch.eye(n)).abs().max()) < 5 * (2 / count) ** 0.5
    assert torch.equal(start[:, n:], torch.tensor([0.0, 1.0, 0.0]).double().expand(count, 3))
    # Tip straight below the joint, as far as it is to be above.
    hanging = float(sim.distance(mean))
    assert hanging == pytest.approx(2 * sim.constants.height)


@pytest.mark.parametrize("name", TASKS)
def test_readings_have_angles_within_half_a_turn(name: str) -> None:
    sim = TASKS[name]()
    n = len(sim.spec.state)
    states = torch.cat([10 * uniform(50, n) - 5, torch.zeros(50, 3).double()], -1)
    for turns in (-7, 0, 1):
        turned = [turns * quantity.period for quantity in sim.spec.state]
        seen = sim.observe(states + torch.tensor([*turned, 0, 0, 0], dtype=torch.float64))
        for k, quantity in enumerate(sim.spec.state):
            if quantity.period:
                assert float(seen[:, k].abs().max()) <= math.pi
                gap = (seen[:, k] - states[:, k]) / quantity.period
                torch.testing.assert_close(gap, gap.round(), rtol=0, atol=1e-12)
            else:
                assert torch.equal(seen[:, k], states[:, k])


@pytest.mark.parametrize("name", TASKS)
def test_states_are_judged_as_rows_are(name: str) -> None:
    sim = TASKS[name](time_limit=0.5, hold_from=0.3, width=0.6 * TASKS[name]().constants.height)
    ticks, n, batch = round(0.5 / sim.spec.dt), len(sim.spec.state), 200
    # From near upright, so that some succeed.
    start = sim.initial(uniform(batch, n, seed=1))
    start[:, :n] = 0.3 * (2 * uniform(batch, n, seed=2) - 1)
    high = torch.tensor([quantity.high for quantity in sim.spec.action]).double()
    actions = 0.3 * high * (2 * uniform(batch, ticks, len(high), seed=3) - 1)
    states = roll_out(sim, actions, start)
    outcome = sim.outcome(states)
    assert bool((outcome[:, :-1] == int(Outcome.RUNNING)).all())
    succeeded = outcome[:, -1] == int(Outcome.SUCCEEDED)
    assert 5 < int(succeeded.sum()) < batch - 5
    assert bool((outcome[~succeeded, -1] == int(Outcome.TIMED_OUT)).all())
    assert torch.equal(sim.judge(sim.observe(states)), succeeded)
    assert torch.equal(sim.judge(sim.observe(states).unflatten(0, (20, 10))).flatten(), succeeded)
    # One that was cut short is none, and what comes after the time limit does not count.
    assert not bool(sim.judge(sim.observe(states)[:, :-1]).any())
    later = torch.cat([sim.observe(states), torch.full((batch, 2, n), math.pi).double()], 1)
    assert torch.equal(sim.judge(later), succeeded)
    found = sim.measures(states[:, 0], states[:, -1], torch.ones(batch).double())
    first = math.ceil(0.3 / sim.spec.dt - 0.5)
    away = sim.distance(states, sim.spec.dt * torch.arange(ticks + 1))[:, first:]
    torch.testing.assert_close(found["tip_distance_m"], away[:, -1])
    torch.testing.assert_close(found["tip_rms_m"], (away**2).mean(-1).sqrt())


def test_the_window() -> None:
    sim = PendulumSwingUp()
    upright, fallen = torch.zeros(41, 2).double(), torch.tensor([math.pi, 0.0]).double()
    for tick, succeeds in ((0, True), (29, True), (30, False), (35, False), (40, False)):
        states = upright.clone()
        states[tick] = fallen
        assert bool(sim.judge(states)) is succeeds
        # By the rows: a tick that ends there counts from ``hold_from`` on.
        full = torch.tensor([math.pi, 0.0, tick - 1.0, 1.0, 0.0]).double()
        after = sim.step(full, torch.zeros(1).double(), torch.zeros(0).double())
        if tick > 0:
            assert bool(after[3] == 1.0) is succeeds
    # Just within and just outside: the chord of an angle is 2 sin(angle / 2).
    edge = 2 * math.asin(0.25)
    for angle, succeeds in ((edge - 1e-9, True), (edge + 1e-9, False), (math.nan, False)):
        states = upright.clone()
        states[33, 0] = angle
        assert bool(sim.judge(states)) is succeeds
    longer = PendulumSwingUp(time_limit=8.0)
    assert bool(longer.judge(torch.zeros(81, 2).double()))
    assert not bool(longer.judge(torch.zeros(41, 2).double()))


def test_sensors_leave_the_judgement_alone() -> None:
    inner = PendulumSwingUp()
    sim = Sensed(inner, {"angle": 0.5})
    assert isinstance(sim, JudgesStates) and isinstance(sim, Pictured)
    states = torch.zeros(2, 41, 2).double()
    states[1, 33] = 3.0
    assert sim.judge(states).tolist() == [True, False]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dt": 0.0}, r"dt=0.0: expected a finite number above 0"),
        ({"width": -1.0}, r"width=-1.0: expected"),
        ({"hold_from": 5.0}, r"hold_from=5.0, time_limit=4.0: expected seconds in this order"),
        ({"hold_from": 0.05}, r"from dt=0.1 on"),
        ({"time_limit": math.inf}, r"time_limit=inf"),
        ({"period": 0.0}, r"period=0.0: expected"),
        ({"amplitude": math.nan}, r"amplitude=nan: expected a finite number"),
    ],
)
def test_impossible_arguments(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CartPoleSwingUp(**given)


@pytest.mark.parametrize("name", TASKS)
def test_pictures(name: str) -> None:
    sim = TASKS[name]()
    n, m = len(sim.spec.state), len(sim.spec.action)
    actions = torch.full((1, 5, m), 2.0).double()
    trail = roll_out(sim, actions, sim.initial(uniform(1, n)))[0]
    for part in (trail[:1], trail, trail.float()):
        picture = sim.frame(part)
        assert picture.shape == (270, 480, 3) and picture.dtype == np.uint8
    # The rods are dark, and those of the upright picture above the joint.
    upright, hanging = trail[:1] + 0, trail[:1] + 0
    upright[0, :n], hanging[0, :n] = 0, torch.tensor(sim.mean)
    for part, rows in ((upright, slice(40, 110)), (hanging, slice(160, 230))):
        assert (sim.frame(part)[rows, 240].sum(-1) < 400).mean() > 0.4
    assert not np.array_equal(sim.frame(upright), sim.frame(hanging))
