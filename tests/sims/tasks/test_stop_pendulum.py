"""The pendulum between stops: hits against an adaptive solver, rest, energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from sims.base import Outcome
from sims.tasks.pendulum_swing_up import FRICTION, GRAVITY, LENGTH, MASS
from sims.tasks.stop_pendulum import HIGH, LOW, StopPendulum

LEVER, INERTIA = MASS * GRAVITY * LENGTH / 2, MASS * LENGTH**2 / 3


def moved(state: list[float], torques: list[float], sim: StopPendulum | None = None) -> Tensor:
    """Angles and rates ``[T + 1, 2]`` at the ticks."""
    sim = sim or StopPendulum()
    states = [torch.tensor([*state, 0.0, 1.0, 0.0], dtype=torch.float64)]
    for torque in torques:
        action = torch.tensor([torque], dtype=torch.float64)
        states.append(sim.step(states[-1], action, torch.zeros(0).double()))
    return torch.stack(states)[:, :2]


def test_a_hit_against_an_adaptive_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    for start, torque, stop in (((math.pi, 0.5), 3.0, HIGH), ((0.2, -1.0), -3.0, LOW)):

        def slope(_: float, s: np.ndarray, torque: float = torque) -> list[float]:
            return [s[1], (torque + LEVER * math.sin(s[0]) - FRICTION * s[1]) / INERTIA]

        def gap(_: float, s: np.ndarray, stop: float = stop) -> float:
            return s[0] - stop

        gap.terminal = True  # type: ignore[attr-defined]
        exact = solve_ivp(
            slope, (0, 2), start, events=gap, rtol=1e-12, atol=1e-12, dense_output=True
        )
        hit = float(exact.t_events[0][0])
        free = math.floor(hit / 0.05)
        assert free >= 3
        found = moved(list(start), [torque] * (free + 5))
        for k in range(1, free + 1):
            assert found[k].tolist() == pytest.approx(exact.sol(0.05 * k).tolist(), abs=1e-7)
        assert found[free + 1 :].tolist() == [[stop, 0.0]] * 5
        # The time of the hit, by a tick that ends just before and one that ends just after it.
        for late, resting in ((-1e-6, False), (1e-6, True)):
            with monkeypatch.context() as fine:
                fine.setattr(StopPendulum, "substeps", 60)
                there = moved(list(start), [torque], StopPendulum(dt=hit + late))[-1]
            assert (float(there[1]) == 0.0) is resting


def test_rest_at_a_stop_lasts_while_the_torque_presses() -> None:
    # Gravity's torque at the lower stop is -2.35, at the upper one -1.91 N m.
    for stop, outward in ((LOW, -1), (HIGH, 1)):
        balance = -LEVER * math.sin(stop)
        for part, stays in ((0.01, True), (-0.01, False)):
            after = moved([stop, 0.0], [balance + part * outward] * 3)
            assert (after.tolist() == [[stop, 0.0]] * 4) is stays
            assert bool((outward * (after[1:, 0] - stop) < 0).all()) is not stays


def test_no_energy_is_gained_and_no_stop_is_passed() -> None:
    sim, ticks, batch = StopPendulum(), 40, 200
    generator = torch.Generator().manual_seed(0)
    state = sim.initial(torch.rand(batch, 2, generator=generator, dtype=torch.float64))
    hits = 0

    def energy(s: Tensor) -> Tensor:
        return INERTIA / 2 * s[:, 1] ** 2 + LEVER * s[:, 0].cos()

    torque = torch.zeros(batch, 1).double()
    for k in range(ticks):
        if k % 10 == 0:
            torque = 6 * torch.rand(batch, 1, generator=generator, dtype=torch.float64) - 3
        after = sim.step(state, torque, torch.zeros(batch, 0).double())
        work = torque[:, 0] * (after[:, 0] - state[:, 0])
        lost = energy(state) + work - energy(after)
        assert float(lost.min()) > -1e-9
        assert float(after[:, 0].min()) >= LOW and float(after[:, 0].max()) <= HIGH
        hits += int((lost > 0.1).sum())
        state = after
    assert hits > 50


def test_the_stop_beyond_upright_holds_the_rod() -> None:
    # Its tip is 2 sin(0.25) = 0.495 m from upright, too far by the task's own width.
    sim = StopPendulum(time_limit=3.5, width=0.5)
    state = sim.initial(torch.full((1, 2), 0.5).double())
    for k in range(70):
        torque = torch.full((1, 1), 3.0 if k < 15 else -3.0).double()
        state = sim.step(state, torque, torch.zeros(1, 0).double())
    assert state[0, :2].tolist() == [LOW, 0.0]
    assert sim.outcome(state).tolist() == [int(Outcome.SUCCEEDED)]
    assert float(sim.distance(state)) == pytest.approx(2 * math.sin(0.25))


def test_stops_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = StopPendulum()
    states = torch.tensor([[math.pi, 0.0, 0.0, 1.0, 0.0]]).double()
    with_stops = sim.frame(states)
    monkeypatch.setattr(StopPendulum, "walls", ())
    changed = (with_stops != sim.frame(states)).any(-1)
    assert changed[:130].any() and changed[140:].any() and not changed[:, :230].any()
