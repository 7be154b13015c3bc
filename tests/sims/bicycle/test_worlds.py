"""The bicycle's harder worlds: what is drawn and kept, the change in mid-ride, starts, signs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from sims.base import Lasting, Outcome, Sim
from sims.bicycle import RANDLOV, Bicycle, Physics, step
from sims.bicycle.life import DRAWN
from sims.bicycle.optimum import shortest_time
from sims.bicycle.slalom import Slalom
from sims.sensing import Sensed
from tests.populations import bicycle_training
from tests.sims.bicycle.test_bicycle import falls

CHANGE = {"M_p": 90.0, "v": 5.0}
LATER = replace(RANDLOV, M_p=90.0, v=5.0)


def uniform(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def f64(*numbers: float) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def test_drawn_constants_are_uniform_and_independent() -> None:
    sim, count = Bicycle(spread=0.3), 20_000
    physics = sim.constants(sim.initial(uniform(count, 8)))
    drawn = torch.stack([getattr(physics, name) / getattr(RANDLOV, name) for name in DRAWN])
    assert float(drawn.min()) >= 0.7 and float(drawn.max()) <= 1.3
    assert drawn.mean(1).tolist() == pytest.approx([1.0] * 7, abs=5 * 0.173 / count**0.5)
    assert drawn.std(1).tolist() == pytest.approx([0.3 / math.sqrt(3)] * 7, rel=0.02)
    apart = torch.corrcoef(drawn) - torch.eye(7).double()
    assert float(apart.abs().max()) < 5 / count**0.5
    assert torch.allclose(
        torch.as_tensor(physics.c / physics.l), torch.tensor(0.66 / 1.11).double()
    )
    for name in ("g", "r", "theta_max", "omega_max"):
        assert getattr(physics, name) == getattr(RANDLOV, name)


def test_drawn_constants_are_those_that_act_and_are_kept_for_life() -> None:
    sim, count = Bicycle(spread=0.3), 4
    state = sim.initial(uniform(count, 8))
    born, action = sim.constants(state), uniform(count, 2, seed=1) * 0.02
    for k in range(count):
        own = {n: float(getattr(born, n)[k]) for n in (*DRAWN, "c")}
        alone = replace(RANDLOV, **own)
        assert float((state[k, 6:8] - state[k, 8:10]).norm()) == pytest.approx(own["l"])
        wanted = step(state[k, :10], action[k], f64(0.01)[0], physics=alone)
        got = sim.step(state[k], action[k], f64(0.75, 0.5, 0.5))
        assert torch.allclose(got[:10], wanted, rtol=1e-13, atol=1e-15)
    for seed in (2, 3):
        state = sim.step(state, action, uniform(count, 3, seed=seed))
        state = sim.restart(
            state, torch.ones(count, dtype=torch.bool), uniform(count, 8, seed=seed)
        )
        kept = sim.constants(state)
        assert all(torch.equal(getattr(kept, name), getattr(born, name)) for name in DRAWN)
        distance = (state[:, 6:8] - state[:, 8:10]).norm(dim=-1)
        assert torch.allclose(distance, torch.as_tensor(born.l))


def test_measures_of_a_drawn_bicycle_are_its_own() -> None:
    sim = Bicycle(spread=0.3)
    start = sim.initial(uniform(3, 8))
    measures = sim.measures(start, start, torch.full((3,), 10.0).double())
    physics = sim.constants(start)
    assert torch.equal(measures["path_length_m"], 10 * torch.as_tensor(physics.v))
    for k in range(3):
        own = replace(RANDLOV, **{n: float(getattr(physics, n)[k]) for n in (*DRAWN, "c")})
        wanted = shortest_time(start[k, :10], physics=own)
        assert float(measures["shortest_time_s"][k]) == pytest.approx(float(wanted), rel=1e-12)


def test_a_change_comes_at_its_time_and_stays() -> None:
    sim = Bicycle(change_at=0.03, change=CHANGE, noise=0.0)
    half, action = torch.tensor([0.5]).double(), torch.tensor([0.3, 0.01]).double()
    state = sim.initial(torch.tensor([0.4]).double())
    plain = state[:10]
    zero = torch.tensor(0.0).double()
    for k in range(8):
        if k == 5:  # a new ride in the same life
            state = sim.restart(state, torch.tensor(True), torch.tensor([0.9]).double())
            plain = state[:10]
        physics = RANDLOV if k < 3 else LATER
        assert float(state[10]) == k
        state, plain = sim.step(state, action, half), step(plain, action, zero, physics=physics)
        assert torch.allclose(state[:10], plain, rtol=1e-14, atol=1e-16)
    assert float(torch.as_tensor(sim.constants(state).v)) == 5.0


def test_the_tyres_path_has_its_length_through_the_change() -> None:
    sim = Bicycle(change_at=0.5, change=CHANGE, noise=0.0)
    state = sim.initial(uniform(3, 1))
    state[:, 10] = torch.tensor([0.0, 30.0, 60.0]).double()  # before, before, after the change
    states = [state]
    for _ in range(100):
        states.append(sim.step(states[-1], uniform(3, 2) * 0.02, torch.full((3, 1), 0.5).double()))
    path = torch.stack(states)[:, :, 6:8].diff(dim=0).norm(dim=-1).sum(0)
    measured = sim.measures(states[0], states[-1], torch.ones(3).double())["path_length_m"]
    assert torch.allclose(path, measured, rtol=1e-12)
    assert measured.tolist() == pytest.approx([0.5 * (10 / 3.6 + 5), 0.2 * 10 / 3.6 + 4, 5.0])


def test_the_shortest_time_through_the_change() -> None:
    ahead = -math.pi / 2
    sim = Bicycle(change_at=180.0, change=CHANGE, start_heading_low=ahead, start_heading_high=ahead)
    start = sim.initial(torch.zeros(3, 1).double())
    start[:, 10] = torch.tensor([0.0, 18_000.0, 1e6]).double()
    shortest = sim.measures(start, start, torch.zeros(3).double())["shortest_time_s"]
    metres = 1000 - 10 - 1.11
    slow = 180 * 10 / 3.6
    wanted = [180 + (metres - slow) / 5, metres / 5, metres / 5]
    assert shortest.tolist() == pytest.approx(wanted, abs=0.01)


def test_a_drawn_bicycle_changes_by_its_own_factors() -> None:
    sim = Bicycle(spread=0.2, change_at=0.0, change=CHANGE)
    before = Bicycle(spread=0.2).constants(Bicycle(spread=0.2).initial(uniform(5, 8)))
    after = sim.constants(sim.initial(uniform(5, 8)))
    assert torch.allclose(torch.as_tensor(after.M_p), torch.as_tensor(before.M_p) * 1.5)
    assert torch.allclose(torch.as_tensor(after.v), torch.as_tensor(before.v) * 1.8)
    assert torch.equal(torch.as_tensor(after.h), torch.as_tensor(before.h))


def test_starts_off_balance() -> None:
    lean, bar = math.radians(6), math.radians(20)
    sim = Bicycle(start_lean=lean, start_handlebar=bar)
    start = sim.initial(uniform(20_000, 3))
    for column, most in ((2, lean), (0, bar)):
        angles = start[:, column]
        assert float(angles.abs().max()) <= most
        assert float(angles.mean()) == pytest.approx(0, abs=0.02 * most)
        assert float(angles.std()) == pytest.approx(most / math.sqrt(3), rel=0.02)
    assert abs(float(torch.corrcoef(start[:, [0, 2, 5]].T)[0, 1])) < 0.03
    assert torch.equal(start[:, [1, 3, 4]], torch.zeros(20_000, 3).double())
    plain = Bicycle().initial(uniform(20_000, 3)[:, :1])
    assert torch.equal(start[:, 5:], plain[:, 5:])


def test_with_true_precession_it_stands_untouched_for_2_96_seconds() -> None:
    right = Bicycle(physics=Physics(true_precession=True))
    mean, C = (float(falls(sim, 4000).mean()) for sim in (right, Bicycle()))
    # One ride's standard deviation is half a second.
    assert mean == pytest.approx(2.96, abs=0.04)
    assert C == pytest.approx(1.69, abs=0.02)


def test_true_precession_does_no_work() -> None:
    """What the front wheel's spin gives to the handlebar it takes from the lean."""
    state = f64(0, 0.7, 0, 0.3, 0, 0, 0, 1.11, 0, 0)
    power = {}
    for right in (True, False):
        p = Physics(true_precession=right)
        new = step(state, f64(0, 0), f64(0)[0], physics=p)
        of_lean = float(new[4]) * float(p.I_B) * 0.3
        # The C program takes I_dv = 3/2 I_dc in one of the two terms, where I_dc belongs.
        of_handlebar = float(new[1] - state[1]) / 0.01 * float(0.5 * p.I_d) * 0.7 / 1.5
        power[right] = of_lean + of_handlebar
    assert power[True] == pytest.approx(0, abs=1e-12)
    assert power[False] < -0.1


def test_the_plain_bicycle_carries_nothing() -> None:
    sim = Bicycle()
    assert (sim.width, sim.lasting) == (10, ())
    assert isinstance(sim, Lasting)
    assert (sim.spec.reset_dim, sim.spec.disturbance_dim) == (1, 1)
    assert sim.constants(sim.initial(uniform(2, 1))) is RANDLOV


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"spread": -0.1}, "spread=-0.1: expected at least 0 and below 1"),
        ({"spread": 1.0}, "spread=1.0: expected at least 0 and below 1"),
        ({"spread": math.nan}, "spread=nan: expected"),
        ({"gust": -1.0}, "gust=-1.0: expected a finite number, 0 or more"),
        ({"gust": 1.0, "gust_seconds": 0.0}, "gust_seconds=0.0: expected"),
        ({"gust": 1.0, "gust_seconds": 6.0}, "gust_seconds=6.0: expected dt, 0.01 s, at least"),
        ({"gust": 1.0, "gust_every": math.inf}, "gust_every=inf: expected"),
        ({"start_lean": 0.3}, "start_lean=0.3: expected from 0 to 0.2094 rad"),
        ({"start_lean": -0.1}, "start_lean=-0.1: expected"),
        ({"start_handlebar": 1.5}, "start_handlebar=1.5: expected from 0 to 1.3963 rad"),
        ({"change_at": -1.0, "change": CHANGE}, "change_at=-1.0: expected"),
        ({"change_at": 10.0}, "change_at=10.0: expected a change at that time"),
        ({"change_at": 1.0, "change": {"l": 1.0}}, "change='l': expected names of v, g"),
        ({"change_at": 1.0, "change": {"v": 0.0}}, "change.v=0.0: expected a finite number"),
    ],
)
def test_refuses_impossible_worlds(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        Bicycle(**arguments)
    assert message in str(refusal.value)


EVERYTHING: dict[str, Any] = {
    "spread": 0.3,
    "gust": 10.0,
    "gust_every": 1.5,
    "start_lean": 0.1,
    "change_at": 1.0,
    "change": CHANGE,
}


def training(sim: Sim, seeds: list[int]) -> Training:
    """Learners in ``sim`` instead of the plain bicycle."""
    learner = bicycle_training([0], Budget(seconds=3.0)).learner
    return Training(learner, World(sim), seeds, Budget(seconds=3.0))


@pytest.mark.parametrize(
    "sim",
    [Bicycle(**EVERYTHING), Sensed(Slalom(**EVERYTHING), {"lean": 0.01}, 2)],
    ids=["bicycle", "slalom, sensed"],
)
def test_a_seed_lives_the_same_life_in_any_company(sim: Sim) -> None:
    alone, together = training(sim, [5]), training(sim, [3, 5, 8])
    for one in (alone, together):
        one.advance(200)
    assert torch.equal(alone.worlds.world[0], together.worlds.world[1])
    lasting = list(sim.lasting) if isinstance(sim, Lasting) else []
    born = training(sim, [3, 5, 8]).worlds.world
    factors = lasting[:-1]  # the last one is the age
    assert torch.equal(together.worlds.world[:, factors], born[:, factors])
    assert not torch.equal(born[0, factors], born[1, factors])
    assert together.worlds.world[:, lasting[-1]].tolist() == [200.0] * 3
    assert max(e.number for e in together.episodes) > 0


def test_noise_three_and_five_times_is_a_setting() -> None:
    for noise in (0.06, 0.10):
        sim = Bicycle(noise=noise)
        state, action = sim.initial(uniform(1, 1)), torch.zeros(1, 2).double()
        pushed = sim.step(state, action, torch.ones(1, 1).double())
        assert torch.equal(pushed, step(state, action, f64(noise)))


def test_a_changed_bicycle_can_start_a_ride() -> None:
    state = Bicycle(**EVERYTHING).initial(uniform(6, 10))
    assert Bicycle(**EVERYTHING).outcome(state).tolist() == [Outcome.RUNNING] * 6
