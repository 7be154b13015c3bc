"""The regulator that knows the bicycle: its linearisation, its optimality, what it saves."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from edtorch.value.linear.lqr import stationary_lqr
from sims.base import Measured
from sims.bicycle import RANDLOV, Bicycle, Physics, semi_implicit
from sims.bicycle.lqr import ACTION_COST, STATE_COST, BicycleLqr, linearised, regulator, saved

COSTS = (torch.tensor(STATE_COST).double(), torch.tensor(ACTION_COST).double())


def test_the_linearisation_is_that_of_the_equations() -> None:
    p = replace(RANDLOV, true_precession=True, v=4.0)
    F, G = linearised(p, semi_implicit, 0.01)
    weight = 0.01 * float(p.h * p.M * p.g / p.I_B)
    assert float(F[3, 2]) == pytest.approx(weight, rel=1e-12)
    assert float(G[3, 1]) == pytest.approx(weight / float(p.h), rel=1e-12)
    assert float(G[1, 0]) == pytest.approx(0.01 / (0.5 * float(p.I_d)), rel=1e-12)
    assert float(F[1, 3]) == pytest.approx(0.03 * float(p.sigma_dot), rel=1e-12)
    turning = 2 * p.M_d * p.r + p.M * p.h
    assert float(F[3, 0]) == pytest.approx(-0.01 * p.v**2 / p.l * turning / p.I_B, rel=1e-12)
    assert float(F[4, 0]) == pytest.approx(0.01 * p.v / p.l, rel=0.01)


def test_every_bicycle_has_its_own() -> None:
    speeds = torch.tensor([2.0, 3.0, 5.0]).double()
    F, G = linearised(replace(RANDLOV, v=speeds), semi_implicit, 0.01)
    assert F.shape == (3, 5, 5) and G.shape == (3, 5, 2)
    gains = regulator(F, G, *COSTS)
    for k in range(3):
        alone = linearised(replace(RANDLOV, v=float(speeds[k])), semi_implicit, 0.01)
        assert torch.allclose(F[k], alone[0]) and torch.allclose(G[k], alone[1])
        assert torch.allclose(gains[k], regulator(*alone, *COSTS))


def test_the_gains_are_optimal_and_stable() -> None:
    F, G = linearised(RANDLOV, semi_implicit, 0.01)
    gain = regulator(F, G, *COSTS)
    wanted, _ = stationary_lqr(F, G, torch.diag(COSTS[0]), torch.diag(COSTS[1]))
    assert torch.allclose(gain, wanted, rtol=1e-6)
    assert float(torch.linalg.eigvals(F + G @ gain).abs().max()) < 1
    assert float(torch.linalg.eigvals(F).abs().max()) > 1


def test_what_cannot_be_held_upright_is_refused() -> None:
    F, G = linearised(RANDLOV, semi_implicit, 0.01)
    with pytest.raises(ValueError, match="cannot be held upright"):
        regulator(F, 0 * G, *COSTS)


@pytest.mark.oracle
def test_which_starts_it_saves() -> None:
    degrees = math.radians(1)
    sim = Bicycle(start_lean=6 * degrees, start_handlebar=20 * degrees)
    generator = torch.Generator().manual_seed(0)
    start = sim.initial(torch.rand(500, 3, generator=generator, dtype=torch.float64))
    numbers = torch.rand(500, 500, 1, generator=generator, dtype=torch.float64)
    assert float(saved(sim, start).double().mean()) > 0.99
    assert float(saved(sim, start, numbers).double().mean()) > 0.99
    lost = start.clone()
    lost[:, 2], lost[:, 3] = 11 * degrees, 1.0
    assert not bool(saved(sim, lost).any())


def test_a_baseline_of_each_bicycle_also_after_the_change() -> None:
    sim = Bicycle(spread=0.3, change_at=0.02, change={"v": 5.0})
    assert isinstance(sim, Measured)
    control = sim.baselines()["lqr"]
    assert isinstance(control, BicycleLqr)
    generator = torch.Generator().manual_seed(0)
    state = sim.initial(torch.rand(3, 8, generator=generator, dtype=torch.float64))
    first = control.gains(state)
    for _ in range(2):
        assert torch.equal(control.gains(state), first)
        state = sim.step(state, control(state), torch.full((3, 3), 0.5).double())
    assert not torch.equal(control.gains(state), first)
    plain = Bicycle(physics=Physics(true_precession=True))
    assert BicycleLqr(plain)(plain.initial(torch.zeros(1, 1).double())).shape == (1, 2)
