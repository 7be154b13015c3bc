"""The walker: work and energy, events within a tick, how its episodes end."""

from __future__ import annotations

import math
from typing import Any

import numba.core.config
import numpy as np
import pytest
import torch
from torch import Tensor

from sims.base import Outcome, Pictured
from sims.conformance import check
from sims.rows import TORCH
from sims.sensing import Sensed
from sims.tasks.five_links import foot_over
from sims.tasks.walker import START, Walker
from tests.sims.tasks.test_five_links import TORQUES, energy

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself

NOTHING = torch.zeros(0).double()


def full(leans: Any, rates: Any) -> Tensor:
    """Full states ``[*batch, 17]``."""
    q = torch.as_tensor(leans, dtype=torch.float64)
    v = torch.as_tensor(rates, dtype=torch.float64).expand_as(q)
    return torch.cat([torch.stack([q, v], -1).flatten(-2), torch.zeros(*q.shape[:-1], 7)], -1)


def drawn(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Full states about the start, in motion, and torques ``[count, 4]``."""
    generator = torch.Generator().manual_seed(seed)

    def normal(n: int) -> Tensor:
        return torch.randn(count, n, generator=generator, dtype=torch.float64)

    leans = torch.tensor(START, dtype=torch.float64) + 0.05 * normal(5)
    leans[:, 0] = leans[:, 0].maximum(leans[:, 1] + 0.05)
    return full(leans, 0.5 * normal(5)), 5 * normal(4)


def about_to_strike(count: int) -> Tensor:
    """States that strike 0.4 m or so ahead within a tick, both knees bent."""
    generator = torch.Generator().manual_seed(3)
    leans = torch.tensor([0.33, 0.22, 0.0, -0.25, -0.12]).double().repeat(count, 1)
    leans = leans + 0.01 * torch.randn(count, 5, generator=generator, dtype=torch.float64)
    rates = torch.tensor([1.5, 1.2, 0.0, 0.3, -0.5]).double().repeat(count, 1)
    # The swing shank closes what gap there is to a height of 3 mm.
    for _ in range(20):
        _, height, *_ = foot_over(TORCH)(leans.unbind(-1), rates.unbind(-1))
        leans[:, 4] -= (height - 0.003) / (0.4 * leans[:, 4].sin())
    return full(leans, rates)


@pytest.mark.oracle
def test_energy_changes_by_the_work_of_the_torques() -> None:
    state, torques = drawn(20)
    sim = Walker(friction=1e6)
    after = sim.step(state, torques, torch.zeros(20, 0).double())
    assert torch.equal(after[:, 10:13], torch.zeros(20, 3).double())
    turned = after[:, 0:10:2] - state[:, 0:10:2]
    work = (turned * (torques @ TORQUES[:5].mT)).sum(-1)
    gained = energy(after[:, 0:10:2], after[:, 1:10:2]) - energy(state[:, 0:10:2], state[:, 1:10:2])
    torch.testing.assert_close(gained, work, rtol=0, atol=1e-9)


@pytest.mark.oracle
def test_a_tick_with_a_strike_is_two_ticks_whose_torques_change_legs() -> None:
    state = about_to_strike(8)
    torques = torch.tensor([5.0, -20.0, 10.0, 3.0]).double().expand(8, 4)
    nothing = torch.zeros(8, 0).double()
    whole = Walker(friction=1e6).step(state, torques, nothing)
    assert torch.equal(whole[:, 11:13], torch.tensor([1.0, 0.0]).double().expand(8, 2))
    assert float(whole[:, 10].min()) > 0.3
    early = Walker(friction=1e6, dt=0.008).step(state, torques, nothing)
    assert torch.equal(early[:, 11], torch.ones(8).double())
    late = Walker(friction=1e6, dt=0.002).step(early, torques.flip(-1), nothing)
    torch.testing.assert_close(late[:, :13], whole[:, :13], rtol=0, atol=1e-7)
    # No energy beyond the work of the torques, whose legs change where the foot strikes.
    before, after = (energy(s[:, 0:10:2], s[:, 1:10:2]) for s in (state, whole))
    assert float((after - before).max()) < -1


@pytest.mark.oracle
def test_ticks_converge_with_their_substeps() -> None:
    # Knee hits within the tick, of one knee, the other and both; and strikes.
    hits = full(
        [[0.1, 0.09, 0.0, 0.25, 0.65], [0.1, 0.0, 0.0, 0.3, 0.31], [0.1, 0.09, 0.0, 0.3, 0.31]],
        torch.tensor([[-2.0, 1, 0, 0, 0], [0, 0, 0, 3, 0], [-2, 1, 0, 3, 0]]),
    )
    state = torch.cat([hits, about_to_strike(3)])
    # The torques keep knees at their stops.
    torques = torch.tensor([-20.0, 0.0, 0.0, -20.0]).double().expand(6, 4)
    nothing, found = torch.zeros(6, 0).double(), []
    for substeps in (4, 40):
        sim = Walker(friction=1e6)
        sim.substeps = substeps
        found.append(sim.step(state, torques, nothing))
    torch.testing.assert_close(found[0], found[1], rtol=0, atol=1e-7)
    opened = [found[0][:3, 2 * a] - found[0][:3, 2 * b] for a, b in ((0, 1), (4, 3))]
    assert float(opened[0][[0, 2]].abs().max()) < 1e-12 and float(opened[0][1]) > 0.05
    assert float(opened[1][[1, 2]].abs().max()) < 1e-12 and float(opened[1][0]) > 0.3


@pytest.mark.oracle
def test_no_knee_passes_its_stop() -> None:
    # Nor where both hit within a tick, and each hit opens the other a little.
    generator = torch.Generator().manual_seed(5)
    sim, state = Walker(150.0, friction=1e6), drawn(200, seed=4)[0]
    high = torch.tensor([q.high for q in sim.spec.action]).double()
    hits = 0
    for _ in range(12):
        torques = high * (2 * torch.rand(200, 4, generator=generator, dtype=torch.float64) - 1)
        after = sim.step(state, torques, torch.zeros(200, 0).double())
        closed = [after[:, 2 * a] - after[:, 2 * b] for a, b in ((0, 1), (4, 3))]
        assert bool(after.isfinite().all()) and float(torch.stack(closed).min()) > -1e-9
        hits += sum(int((gap.abs() < 1e-9).sum()) for gap in closed)
        state = after
    assert hits > 50


def test_time_advances_where_a_knee_is_hit_again_at_once() -> None:
    # A knee at its stop that opens by next to nothing, and torques that close it.
    leans = torch.tensor([[0.1, 0.1, 0.0, 0.25, 0.65]] * 5).double()
    rates = torch.tensor([[0.2, 0.2, 0.0, -1.0, 0.5]] * 5).double()
    rates[:, 0] += torch.tensor([0.0, 1e-9, 1e-7, 1e-5, 1e-3]).double()
    torques = torch.tensor([-40.0, 0.0, 0.0, 0.0]).double().expand(5, 4)
    sim, state = Walker(150.0, friction=1e6), full(leans, rates)
    for k in range(3):
        state = sim.step(state, torques, torch.zeros(5, 0).double())
        assert float((state[:, 0] - state[:, 2]).abs().max()) < 1e-10
        assert float((state[:, 1] - state[:, 3]).abs().max()) < 1e-7
        # All moved on as the one that was locked from the start.
        torch.testing.assert_close(state[:, :10], state[:1, :10].expand(5, 10), rtol=0, atol=1e-3)
        assert bool(((state[:, 6] - 0.25) < -0.008 * (k + 1)).all())
    assert bool((sim.outcome(state) == int(Outcome.RUNNING)).all())


def test_a_locked_knee_opens_where_its_stop_would_have_to_pull() -> None:
    sim, nothing = Walker(), torch.zeros(2, 0).double()
    state = full([[0.1, 0.1, 0.0, 0.25, 0.65]] * 2, [[0.2, 0.2, 0.0, 0.0, 0.0]] * 2)
    torques = torch.tensor([[-20.0, 0, 0, 0], [20.0, 0, 0, 0]]).double()
    after = sim.step(state, torques, nothing)
    assert float(after[0, 0] - after[0, 2]) == pytest.approx(0.0, abs=1e-15)
    assert float(after[1, 0] - after[1, 2]) > 1e-4


def test_how_a_walk_ends() -> None:
    sim = Walker(wanted_steps=3)
    still = full(START, torch.zeros(5))
    tick = torch.arange(3001)
    states = still.expand(3001, 17).clone()
    states[:, 13] = tick
    states[:, 11] = 2
    running, late = int(Outcome.RUNNING), int(Outcome.TIMED_OUT)
    assert sim.outcome(states).tolist() == [running] * 3000 + [late]
    states[:, 11] = 3
    assert sim.outcome(states).tolist() == [running] * 3000 + [int(Outcome.SUCCEEDED)]
    # A low hip, a fall of any kind, no numbers; after enough steps all the same a success.
    low, fallen = still.clone(), still.clone()
    low[[0, 2]] = torch.tensor([1.0, 0.92]).double()  # 0.458 m
    fallen[12] = 1.0
    for state in (low, fallen, still * math.nan):
        for steps, outcome in ((2, Outcome.FAILED), (3, Outcome.SUCCEEDED)):
            ended = state.clone()
            ended[11] = steps
            assert sim.outcome(ended) == int(outcome)


def test_a_foot_slips_leaves_the_ground_or_strikes_too_near() -> None:
    nothing, still = torch.zeros(1, 0).double(), full([START], torch.zeros(5))
    # At rest: held by gravity alone, with 34 N forward for 383 N up.
    held = Walker().step(still, torch.zeros(1, 4).double(), nothing)
    assert float(held[0, 14]) == pytest.approx(34.1 / 383.3, rel=0.01)
    assert held[0, 12] == 0 and held[0, 16] < 40 * 9.81
    slippery = Walker(friction=0.08).step(still, torch.zeros(1, 4).double(), nothing)
    assert slippery[0, 12] == 1 and torch.equal(slippery[0, :10], still[0, :10])
    assert slippery[0, 14] == 0
    # Fast enough, the links pull the foot up.
    spun = Walker(friction=1e6).step(full([START], 6.0 * torch.ones(5)), torch.zeros(1, 4), nothing)
    assert spun[0, 12] == 1 and spun[0, 16] < 0
    # Legs side by side, the swing foot slightly above the ground and falling.
    near = full([[0.31, 0.0, 0.0, 0.01, 0.312]], [[0.5, 0.0, 0.0, 0.0, 0.0]])
    state = near
    for _ in range(2):
        state = Walker(friction=1e6).step(state, torch.zeros(1, 4).double(), nothing)
    assert state[0, 12] == 1 and state[0, 11] == 0
    after = Walker(friction=1e6).step(state, torch.full((1, 4), 9.0).double(), nothing)
    assert torch.equal(after[0, :13], state[0, :13])


@pytest.mark.oracle
def test_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not compiled, which takes long: numba leaves the functions of numbers as they are.
    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    check(Walker(), batches=((1,), (5,)), steps=1)


@pytest.mark.oracle
def test_rows_of_numbers_through_events(monkeypatch: pytest.MonkeyPatch) -> None:
    from sims.compiled_rows import compiled, first_difference

    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    hits = full([[0.1, 0.09, 0.0, 0.25, 0.65]], [[-2.0, 1.0, 0.0, 0.0, 0.0]])
    state = torch.cat([hits, about_to_strike(2)])
    torques, nothing = torch.ones(3, 4).double(), torch.zeros(3, 0).double()
    sim = Walker()
    after = sim.step(state, torques, nothing)
    rows = compiled(sim, "events")
    assert first_difference(rows, "step", (state, torques, nothing), after, 1e-10) is None


@pytest.mark.long
def test_conforms_compiled() -> None:
    check(Walker(150.0), batches=((5,),), steps=60)


def test_starts_sensors_and_torques() -> None:
    sim = Walker()
    draws = torch.rand(20_000, 10, generator=torch.Generator().manual_seed(0)).double()
    start = sim.initial(draws)
    q, v = start[:, 0:10:2], start[:, 1:10:2]
    torch.testing.assert_close(v.std(0), torch.full((5,), 0.1).double(), rtol=0.03, atol=0)
    torch.testing.assert_close(q[:, 1:].std(0), torch.full((4,), 0.02).double(), rtol=0.03, atol=0)
    assert q.mean(0).tolist() == pytest.approx(START, abs=1e-3)
    # One in 150 starts with its knee at the stop.
    assert float((q[:, 0] - q[:, 1]).min()) == 0.0 and float((q[:, 4] - q[:, 3]).min()) > 0.2
    for knee in (25.0, 150.0):
        assert [q.high for q in Walker(knee).spec.action] == [knee, 150.0, 150.0, knee]
    sensed = Sensed(sim, {"torso": 0.001})
    assert isinstance(sensed, Pictured) and "steps" in [q.name for q in sensed.spec.state]
    without = Walker(foot=False)
    assert torch.equal(without.observe(start), sim.observe(start)[:, :10])


def test_measures() -> None:
    sim = Walker()
    start = sim.initial(torch.full((1, 10), 0.5).double())
    final = start.clone()
    final[0, [10, 11, 14]] = torch.tensor([2.0, 7.0, 0.5]).double()
    found = sim.measures(start, final, torch.ones(1).double())
    values = {name: float(value) for name, value in found.items()}
    assert values == {"steps": 7.0, "distance_m": 2.0, "friction_used": 0.5}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"knee_torque": 0.0}, r"knee_torque=0.0: expected a finite number above 0"),
        ({"friction": math.nan}, r"friction=nan: expected"),
        ({"wanted_steps": 0.5}, r"wanted_steps=0.5: expected a whole number, 1 or more"),
        ({"time_limit": 0.001}, r"time_limit=0.001: expected at least dt=0.01"),
    ],
)
def test_impossible_arguments(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Walker(**given)


def test_pictures() -> None:
    sim, trail = Walker(), full([START] * 3, torch.zeros(5))
    trail[:, 10] = torch.tensor([0.0, 0.1, 0.2]).double()
    for part in (trail[:1], trail, trail.float()):
        picture = sim.frame(part)
        assert picture.shape == (270, 480, 3) and picture.dtype == np.uint8
    # Upright on one leg, the torso above the hip; a leg keeps its colour where labels change.
    upright = full([[0.0] * 5], torch.zeros(5))
    assert (sim.frame(upright)[30:220, 240].sum(-1) < 450).mean() > 0.9
    swapped = trail[:1].clone()
    swapped[:, 0:10:2] = trail[:1, 0:10:2].flip(-1)
    swapped[:, 10:12] = torch.tensor([-0.27, 1.0]).double()
    assert np.abs(sim.frame(swapped)[160, :].astype(int) - sim.frame(trail[:1])[160, :]).max() < 250
