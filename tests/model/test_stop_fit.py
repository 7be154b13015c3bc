"""Stops found in data of a pendulum between them."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from edtorch.errors import Contradicted, FitError
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure, accelerations
from edtorch.model.path_fit import fit_paths
from edtorch.model.stop_fit import find_events
from edtorch.model.stops import Stops
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from edtorch.types import Transition
from sims.tasks.pendulum_swing_up import FRICTION, GRAVITY, LENGTH, MASS
from sims.tasks.stop_pendulum import HIGH, LOW, StopPendulum

TOLD = Told.of(StopPendulum().spec)
STRUCTURE = Structure.of(TOLD, Lift.of(TOLD), Terms.implicit(TOLD, Lift.of(TOLD)))
LEVER, INERTIA = MASS * GRAVITY * LENGTH / 2, MASS * LENGTH**2 / 3
NOISE = 0.003
FIT = partial(fit_paths, passes=2)


def stops(lower: float | None = None, upper: float | None = None) -> Stops:
    """Between which the rod swings."""
    return Stops.of(
        TOLD,
        {
            "lower": {"of": {"angle": 1.0}, "column": "torque", "at": lower},
            "upper": {"of": {"angle": -1.0}, "column": "torque", "at": upper},
        },
    )


def data(start: float, size: float = 3.0, ticks: int = 160) -> tuple[Transition, torch.Tensor]:
    """Readings under torques of up to ``size`` N m that last for half a second; and which ticks
    begin or end at the lower and at the upper stop, ``[ticks, 2]``."""
    sim, generator = StopPendulum(), np.random.default_rng(0)
    torque = np.repeat(generator.uniform(-size, size, ticks // 10), 10)[:, None, None]
    state = torch.tensor([[start, 0.0, 0.0, 1.0, 0.0]], dtype=torch.float64)
    states, touched = [state], []
    for u in torch.from_numpy(torque):
        state = sim.step(state, u, torch.zeros(1, 0).double())
        states.append(state)
        two = torch.cat(states[-2:])[:, 0]
        touched.append([bool(((two - w).abs() < 1e-9).any()) for w in (LOW, HIGH)])
    true = torch.cat(states)[:, :2] / torch.tensor([1.0, 6.0])
    noise = NOISE * torch.from_numpy(generator.standard_normal(true.shape))
    readings = true + noise / torch.tensor([1.0, 6.0])
    readings[:, 0] = torch.remainder(readings[:, 0] + math.pi, 2 * math.pi) - math.pi
    whole = torch.ones(ticks, dtype=torch.bool)
    dt = torch.tensor(0.05, dtype=torch.float64)
    action = torch.from_numpy(torque[:, 0]) / 3
    return Transition(readings[:-1], action, readings[1:], dt, whole), torch.tensor(touched)


def test_stops_are_where_ticks_break() -> None:
    seen = set[str]()
    for start in (math.pi, -0.3):
        transition, touched = data(start)
        found = find_events(STRUCTURE, stops(), transition, FIT)
        names = [n for n, hit in zip(("lower", "upper"), touched.any(0), strict=True) if hit]
        assert list(found.stops.names) == names
        for name, level in zip(names, found.stops.level, strict=True):
            turns = (float(level) - {"lower": LOW, "upper": -HIGH}[name]) / (2 * math.pi)
            assert 2 * math.pi * (turns - round(turns)) == pytest.approx(0, abs=0.004)
        either = touched.any(-1)
        assert not bool((found.free & either).any())
        assert int(found.free.sum()) > 0.7 * int((~either).sum())
        seen |= set(names)
    assert seen == {"lower", "upper"}


def test_the_model_of_free_motion_is_that_without_stops() -> None:
    transition, _ = data(math.pi)
    found = find_events(STRUCTURE, stops(), transition, FIT)
    probe = torch.tensor([[a, r] for a in (2.0, 2.7, 3.4) for r in (-0.3, 0.3)]).double()
    push = torch.full((6, 1), 0.5, dtype=torch.float64)
    exact = (1.5 + LEVER * probe[:, :1].sin() - FRICTION * 6 * probe[:, 1:]) / INERTIA / 6

    def error(valid: torch.Tensor) -> float:
        weight = fit_paths(STRUCTURE, replace(transition, valid=valid)).weight
        return float((accelerations(STRUCTURE, weight, probe, push) - exact).abs().max())

    assert error(found.free) < 0.15
    assert error(transition.valid) > 3 * error(found.free)


def test_without_a_hit_there_is_one_mode() -> None:
    transition, touched = data(math.pi, size=0.3)
    assert not bool(touched.any())
    found = find_events(STRUCTURE, stops(), transition, FIT)
    assert len(found.stops) == 0 and bool(found.free.all())
    assert len(found.notes) == 2


def test_readings_beyond_a_stop_that_is_told_are_an_error() -> None:
    transition, _ = data(math.pi)
    with pytest.raises(Contradicted, match=r"told.stops.upper.at=-3.24159: \d+ of 160 readings"):
        find_events(STRUCTURE, stops(None, -(HIGH - 0.3)), transition, FIT)
    outlier = transition.next_state.clone()
    outlier[80, 0] = HIGH + 0.3
    with pytest.raises(FitError, match=r"at=-3.54159: 1 of 160 readings lie"):
        one = replace(transition, next_state=outlier)
        find_events(STRUCTURE, stops(None, -HIGH), one, FIT)
    found = find_events(STRUCTURE, stops(LOW, -HIGH), transition, FIT)
    assert found.stops.names == ("lower", "upper") and not found.notes


def test_messages_are_in_physical_units() -> None:
    told = replace(TOLD, unit=(2.0, 6.0))
    lift = Lift.of(told)
    structure = Structure.of(told, lift, Terms.implicit(told, lift))
    per_unit = torch.tensor([0.5, 1.0], dtype=torch.float64)
    transition, _ = data(math.pi)
    transition = replace(
        transition, state=transition.state * per_unit, next_state=transition.next_state * per_unit
    )
    of = {"of": {"angle": -1.0}, "column": "torque"}
    found = find_events(structure, Stops.of(told, {"upper": of}), transition, FIT)
    (level,) = (float(n.split("learned at ")[1]) for n in found.notes)
    assert found.notes[0].startswith("told.stops.upper.at=null: learned at ")
    turns = (level + HIGH) / (2 * math.pi)
    assert 2 * math.pi * (turns - round(turns)) == pytest.approx(0, abs=0.004)
    with pytest.raises(Contradicted, match=r"at=-3.24159: .* by up to 0.3\d*; is") as error:
        wrong = of | {"at": -(HIGH - 0.3)}
        find_events(structure, Stops.of(told, {"upper": wrong}), transition, FIT)
    assert "scaled" not in str(error.value)


def test_too_few_free_ticks_leave_one_smooth_model() -> None:
    transition, _ = data(math.pi, size=0.3)
    pressed = replace(transition, action=transition.action * 0 + 1)
    at_stop = torch.tensor([HIGH - 2 * math.pi, 0.0], dtype=torch.float64)
    pressed = replace(
        pressed, state=0 * pressed.state + at_stop, next_state=0 * pressed.state + at_stop
    )
    found = find_events(STRUCTURE, stops(None, -HIGH), pressed, fit_paths)
    assert len(found.stops) == 0 and bool(found.free.all())
    assert any("0 of 160 ticks are free of hits" in note for note in found.notes)
