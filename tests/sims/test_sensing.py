"""Sensors: how far they err, by how much they are late, and that nothing else changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from torch import Tensor

from sims.base import Controller, Fallible, Invertible, Lasting, Measured, Pictured, baselines_of
from sims.bicycle import Bicycle
from sims.bicycle.slalom import Slalom
from sims.linear import LinearSystem
from sims.rows import NoRows, rows_of, stacked, unstacked
from sims.sensing import Sensed


def uniform(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def ride(sim: Any, steps: int, batch: int = 3) -> list[Tensor]:
    """States of ``steps`` steps with actions and numbers that do not depend on the sensors."""
    spec = sim.spec
    states = [sim.initial(uniform(batch, 20)[:, : spec.reset_dim])]
    for k in range(steps):
        numbers = uniform(batch, 20, seed=k)[:, : spec.disturbance_dim]
        states.append(sim.step(states[-1], 0.01 * uniform(batch, 2, seed=100 + k), numbers))
    return states


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_delay_is_exact(delay: int) -> None:
    sim, late = Bicycle(), Sensed(Bicycle(), {}, delay)
    states, sensed = ride(sim, 10), ride(late, 10)
    for k in range(11):
        assert torch.equal(sensed[k][:, :10], states[k])
        assert torch.equal(late.observe(sensed[k]), sim.observe(states[max(0, k - delay)]))
        if k:
            assert late.stepped(sensed[k]).tolist() == [k > delay] * 3
        assert torch.equal(late.outcome(sensed[k]), sim.outcome(states[k]))


def test_a_new_episode_begins_with_a_reading_of_its_start() -> None:
    sim = Bicycle()
    late = Sensed(sim, {"lean": 0.01}, 2)
    state = ride(late, 5, batch=2)[-1]
    new = late.restart(state, torch.tensor([True, False]), uniform(2, 6, seed=50))
    assert torch.equal(new[1], state[1])
    assert torch.equal(new[0], late.initial(uniform(2, 6, seed=50))[0])
    seen, true = late.observe(new)[0], sim.observe(new[0, :10])
    assert torch.equal(seen[1:], true[1:]) and 0 < abs(float(seen[0])) < 0.05


def test_errors_have_their_standard_deviation_and_no_memory() -> None:
    noise = {"lean": 0.0035, "handlebar_rate": 0.0175}
    sim, count = Sensed(Bicycle(), noise), 20_000
    begin = sim.initial(uniform(count, 6))
    after = sim.step(begin, torch.zeros(count, 2).double(), uniform(count, 6, seed=1))
    errors = [sim.observe(s) - Bicycle().observe(s[:, :10]) for s in (begin, after)]
    names = [q.name for q in sim.spec.state]
    for error in errors:
        for k, name in enumerate(names):
            deviation = noise.get(name, 0.0)
            assert float(error[:, k].std()) == pytest.approx(deviation, rel=0.03, abs=1e-15)
            assert float(error[:, k].mean()) == pytest.approx(0, abs=5 * deviation / count**0.5)
    lean = torch.stack([errors[0][:, 0], errors[1][:, 0], errors[1][:, 3]])
    assert float((torch.corrcoef(lean) - torch.eye(3).double()).abs().max()) < 5 / count**0.5


def test_an_angle_that_wraps_stays_within_its_period() -> None:
    west = Bicycle(start_heading_low=math.pi / 2, start_heading_high=math.pi / 2)
    sim = Sensed(west, {"angle_to_goal": 0.1})
    angle = sim.observe(sim.initial(uniform(1000, 6)))[:, 4]
    assert float(angle.abs().max()) <= math.pi
    assert 300 < int((angle > 0).sum()) < 700
    off = torch.remainder(angle, 2 * math.pi) - math.pi
    assert float(off.std()) == pytest.approx(0.1, rel=0.1)


def test_offers_what_the_sim_offers() -> None:
    inner = Slalom(spread=0.3, change_at=1.0, change={"v": 5.0})
    sim = Sensed(inner, {}, 1)
    assert isinstance(sim, Pictured) and isinstance(sim, Measured) and isinstance(sim, Lasting)
    assert not isinstance(sim, Invertible)
    assert sim.traceable and sim.lasting == tuple(range(10, 18))
    states = torch.stack(ride(sim, 3, batch=1))[:, 0]
    assert sim.frame(states).shape == (270, 480, 3)
    control, own = sim.baselines()["lqr"], inner.baselines()["lqr"]
    assert torch.equal(control(states[-1]), own(states[-1, : inner.width + 3]))
    assert baselines_of(sim).keys() == {"lqr"}
    linear = Sensed(LinearSystem([[1.0]], [[1.0]]))
    assert baselines_of(linear) == {}
    assert linear.traceable and linear.lasting == ()
    assert not isinstance(linear, Pictured) and not isinstance(linear, Measured)


def test_steps_that_are_none_are_late_too() -> None:
    @dataclass(frozen=True)
    class Skipping(Bicycle):
        """Every step is one but the fourth."""

        def stepped(self, state: Tensor) -> Tensor:
            return state[..., 10] != 4

    sim = Skipping(change_at=100.0, change={"v": 5.0})
    assert isinstance(sim, Fallible)
    late = Sensed(sim, {}, 2)
    flags = [bool(late.stepped(state)[0]) for state in ride(late, 9)[1:]]
    assert flags == [k > 2 and k - 2 != 4 for k in range(1, 10)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (({"tilt": 0.1},), "noise='tilt': expected names of lean"),
        (({"lean": -0.1},), "noise.lean=-0.1: expected a finite number, 0 or more"),
        (({"lean": math.nan},), "noise.lean=nan: expected"),
        (({}, -1), "delay=-1: expected a whole number of steps"),
        (({}, 0.5), "delay=0.5: expected a whole number of steps"),
    ],
)
def test_refuses_impossible_sensors(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        Sensed(Bicycle(), *arguments)
    assert message in str(refusal.value)


def test_baselines_under_their_former_name() -> None:
    class Former(LinearSystem):
        def yardsticks(self) -> dict[str, Controller]:
            return {"nothing": torch.zeros_like}

    sim = Former([[1.0]], [[1.0]])
    assert baselines_of(sim)["nothing"](torch.ones(3, 1)).tolist() == [[0], [0], [0]]
    sensed = Sensed(sim)
    state = sensed.initial(uniform(3, sensed.spec.reset_dim))
    assert baselines_of(sensed)["nothing"](state).tolist() == [[0], [0], [0]]


@pytest.mark.parametrize(
    "inner",
    [LinearSystem([[1.0]], [[1.0]], noise=0.1), Bicycle(spread=0.2, start_lean=0.1)],
    ids=["linear", "bicycle"],
)
def test_readings_without_a_delay_have_rows(inner: Any) -> None:
    """The same numbers as the tensor functions: noise of plain, bounded and periodic components."""
    noise = {q.name: 0.1 for q in inner.spec.state if q.name not in inner.spec.goal}
    sim = Sensed(inner, noise)
    spec, rows = sim.spec, rows_of(sim)
    start = sim.initial(uniform(9, spec.reset_dim))
    action, draws = uniform(9, len(spec.action), seed=1), uniform(9, spec.disturbance_dim, seed=2)
    after, c = sim.step(start, action, draws), rows.constants
    moved = stacked(rows.step(unstacked(start), unstacked(action), unstacked(draws), c), start)
    assert torch.equal(moved, after)
    again = sim.restart(after, torch.ones(9, dtype=torch.bool), uniform(9, spec.reset_dim, seed=3))
    begun = rows.start(unstacked(after), unstacked(uniform(9, spec.reset_dim, seed=3)), c)
    assert torch.equal(stacked(begun, start), again)
    assert torch.equal(stacked(rows.observe(unstacked(after), c), after), sim.observe(after))
    assert rows.stepped is not None and bool(rows.stepped(unstacked(after), c).all())


def test_what_has_no_rows_says_why() -> None:
    plain: Any = Plain()
    with pytest.raises(NoRows, match="delayed readings"):
        rows_of(Sensed(LinearSystem([[1.0]], [[1.0]]), {}, 1))
    with pytest.raises(NoRows, match="Plain is not written over rows"):
        rows_of(Sensed(plain))


class Plain:
    """Tensor functions alone."""

    def __init__(self) -> None:
        self._sim = LinearSystem([[1.0]], [[1.0]])
        self.spec = self._sim.spec

    def __getattr__(self, name: str) -> Any:
        if name not in ("initial", "restart", "step", "observe", "outcome", "measures"):
            raise AttributeError(name)
        return getattr(self._sim, name)
