"""A model with stops: the compiled tick against the simulator and against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from edtorch.search.tick_model import TickModel
from edtorch.search.ticks import CompiledTicks
from edtorch.transform import Guarded
from sims.tasks.pendulum_swing_up import FRICTION, GRAVITY, LENGTH, MASS
from sims.tasks.stop_pendulum import HIGH, LOW, StopPendulum
from tests.guards import rod
from tests.planning import tick_once
from tests.systems import f64

LEVER, INERTIA = MASS * GRAVITY * LENGTH / 2, MASS * LENGTH**2 / 3
BETWEEN = {
    "lower": {"of": {"angle": 1.0}, "column": "torque", "at": LOW},
    "upper": {"of": {"angle": -1.0}, "column": "torque", "at": -HIGH},
}


def pendulum(saltation: bool = True) -> TickModel:
    """The true one between its stops."""
    told = Told.of(StopPendulum().spec)
    lift = Lift.of(told)
    entries = [lift.entry(name) for name in ("torque", "sin angle", "rate")]
    structure = Structure.of(told, lift, Terms(np.array(entries)[:, None], np.full(3, -1)))
    weight = np.array([[3.0 / 6, LEVER / 6, -FRICTION]]) / INERTIA
    stops = Stops.of(told, BETWEEN)
    return TickModel(structure, weight, 0.05, np.zeros(1), np.ones(1), 5, stops, saltation)


def chain(levels: tuple[float | None, ...] = (0.0, 0.0)) -> TickModel:
    """Two masses on a line, coupled by their accelerations: x'' - y'' / 4 = u - p - 1 - v / 2 and
    y'' - x'' / 4 = p - 2; u keeps x above zero, and p keeps y above x."""
    names = ("1", "x", "y", "v", "w", "u", "p")
    lift = Lift(np.zeros(4, bool), 1 + np.arange(4), np.ones(4), 5, names)
    terms = Terms(np.array([[0], [3], [4], [5], [6], [0], [0]]), np.array([-1] * 5 + [0, 1]))
    source, ratio = np.array([2, 3, -1, -1]), np.array([1.0, 1.0, 0.0, 0.0])
    structure = Structure(lift, terms, np.array([2, 3]), source, ratio)
    weight = np.array([[-1.0, -0.5, 0, 1.0, -1.0, 0, 0.25], [-2.0, 0, 0, 0, 1.0, 0.25, 0]])
    normal = np.array([[1.0, 0, 0, 0], [-1.0, 1.0, 0, 0]])
    names, columns = ("floor", "each other"), np.array([0, 1])
    stops = Stops(names, np.ones(2), normal, np.array(levels), np.zeros(2), columns)
    return TickModel(structure, weight, 0.1, np.zeros(2), np.ones(2), 2, stops)


def after(model: TickModel, state: list[float], action: list[float]) -> np.ndarray:
    """The state one tick later."""
    return tick_once(model, model.weight, np.array(state), np.array(action))[0]


def differences(model: TickModel, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Derivative of a tick by central differences."""
    n = len(model.structure.source)
    ends = [
        [tick_once(model, model.weight, (x + h)[:n], (x + h)[n:])[0] for h in (e, -e)]
        for e in step * np.eye(len(x))
    ]
    return np.array([(ahead - behind) / (2 * step) for ahead, behind in ends]).T


def test_ticks_at_stops_are_those_of_the_simulator() -> None:
    model, sim, generator = pendulum(), StopPendulum(), np.random.default_rng(0)
    size, hits = 400, 0
    angle = np.where(
        np.arange(size) % 2,
        LOW + generator.uniform(0, 0.2, size),
        HIGH - generator.uniform(0, 0.2, size),
    )
    rate, torque = generator.uniform(-6, 6, size), generator.uniform(-3, 3, size)
    angle[:20], rate[:20] = np.where(np.arange(20) % 2, LOW, HIGH), 0.0
    state = torch.tensor(np.stack([angle, rate, 0 * rate, 1 + 0 * rate, 0 * rate], -1))
    moved = sim.step(state, torch.tensor(torque)[:, None], torch.zeros(size, 0).double())
    for k in range(size):
        found = after(model, [angle[k], rate[k] / 6], [torque[k] / 3])
        expected = moved[k, :2].numpy() / [1, 6]
        np.testing.assert_allclose(found, expected, atol=2e-5)
        hits += bool(found[1] == 0)
    assert hits > 40


def test_the_jacobian_is_that_of_finite_differences() -> None:
    model, generator, tried = pendulum(), np.random.default_rng(1), 0
    for _ in range(100):
        low = bool(generator.integers(2))
        angle = (
            LOW + generator.uniform(0.001, 0.15) if low else HIGH - generator.uniform(0.001, 0.15)
        )
        rate = generator.uniform(0.1, 1.0) * (-1 if low else 1)
        x = np.array([angle, rate, generator.uniform(-1, 1)])
        end, by = tick_once(model, model.weight, x[:2], x[2:])
        if min(abs(end[0] - LOW), abs(end[0] - HIGH)) > 1e-9 and abs(end[1]) > 0.005:
            tried += 1
        np.testing.assert_allclose(by, differences(model, x), rtol=2e-4, atol=2e-5)
    assert tried > 5


@pytest.mark.parametrize(
    "state",
    [
        [0.03, 0.5, -1.0, 0.0],  # x hits the floor
        [0.5, 0.52, 0.5, -0.5],  # y hits x, and pushes it
        [0.01, 0.03, -0.3, -1.0],  # both
        [0.0, 0.3, 0.0, 0.2],  # x lies on the floor
    ],
)
def test_hits_of_a_chain_are_differentiated(state: list[float]) -> None:
    model = chain()
    x = np.array([*state, 0.2, -0.4])
    _, by = tick_once(model, model.weight, x[:4], x[4:])
    expected = differences(model, x)
    if state[0] == 0.0:  # the floor gives way to one side only: nothing remains of what is above it
        assert np.abs(by[[0, 2]]).max() < 1e-9
        expected, by = expected[[1, 3], 1:], by[[1, 3], 1:]
        expected, by = np.delete(expected, 1, 1), np.delete(by, 1, 1)
    np.testing.assert_allclose(by, expected, rtol=1e-4, atol=2e-5)


def test_a_falling_mass_lands_when_it_should() -> None:
    """x'' = -1: from 0.003 m at -0.1 m/s it lands after t with .003 = .1 t + t^2 / 2, and lies."""
    model = chain((0.0, -1e3))
    assert after(model, [0.003, 5.0, -0.1, 0.0], [0.0, 2.0])[[0, 2]] == pytest.approx(
        [0, 0], abs=1e-12
    )
    # The force of the floor does not pull: with u = 2.5 the mass rises from rest.
    rising = after(model, [0.0, 5.0, 0.0, 0.0], [2.5, 0.0])
    assert rising[0] > 0.002 and rising[2] > 0.04


def test_impulses_gain_no_energy_and_time_advances() -> None:
    model, generator = chain(), np.random.default_rng(2)
    mass = np.array([[1.0, -0.25], [-0.25, 1.0]])
    for _ in range(200):
        x = generator.uniform(0, 0.05)
        state = [x, x + generator.uniform(0, 0.05), *generator.uniform(-2, 2, 2)]
        end = after(model, state, [0.0, 0.0])
        assert np.isfinite(end).all()
        assert end[0] > -1e-6 and end[1] - end[0] > -1e-6
        work = 0.1 * 3.0 * 4.0  # of forces 1 and 2, no faster than this
        before, later = (0.5 * v @ mass @ v for v in (np.array(state[2:]), end[2:]))
        assert later <= before + work


def test_a_state_beyond_a_stop_is_at_the_stop() -> None:
    model = pendulum()
    for stop, torque in ((LOW, -1.0), (HIGH, 1.0)):
        beyond = after(model, [stop + 0.01 * torque, 0.02 * torque], [torque])
        assert beyond == pytest.approx([stop, 0.0], abs=1e-12)
        turned = after(model, [stop + 0.01 * torque - 2 * math.pi, 0.0], [torque])
        assert turned == pytest.approx([stop - 2 * math.pi, 0.0], abs=1e-12)


def test_without_saltation_the_time_of_a_hit_is_held() -> None:
    """The stop makes the state the same whatever came before it; with the time of the hit held,
    the position keeps its deviation."""
    x = np.array([LOW + 0.05, -0.5])
    with_it = tick_once(pendulum(), pendulum().weight, x, np.array([-1.0]))[1]
    without = tick_once(pendulum(False), pendulum().weight, x, np.array([-1.0]))[1]
    assert np.abs(with_it).max() < 1e-9
    assert without[0, 0] == pytest.approx(1.0, abs=0.05)


def test_a_compiled_tick_at_a_stop_is_a_guarded_one() -> None:
    """Two ways to the same event, and to its derivative: of a force that shuts the stop, and of a
    reset of the rate."""
    x = f64([[LOW + 0.05, -2.0, 0.0], [LOW + 0.12, -3.0, 3.0], [0.4, -1.0, 0.5]])
    ticks, guarded, scale = CompiledTicks(pendulum()), Guarded(rod(), 0.05, 5), f64([1.0, 6.0, 3.0])
    state, action = x[:, :2] / scale[:2], x[:, 2:] / scale[2:]
    assert torch.allclose(ticks(state, action), guarded(x)[:, :2] / scale[:2], atol=1e-6)
    by = guarded.jacobian(x)[:, :2] * scale / scale[:2, None]
    assert torch.allclose(ticks.jacobian(state, action), by, atol=1e-5)
