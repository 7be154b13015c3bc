"""Ticks through stops and strikes against the simulator of a walker, and the fit from readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.model.chain import impact_terms
from edtorch.model.event_free import free_ticks
from edtorch.search.hybrid_fit import LearnedHybrid, learn_hybrid
from edtorch.search.striking import StrikingModel, struck_states
from edtorch.search.tick_model import TickModel
from edtorch.types import Transition
from sims.rows import TORCH
from sims.tasks.five_links import foot_over
from sims.tasks.walker import START, Walker
from tests.walkers import (
    ACTION_UNIT,
    STOPS,
    TOLD,
    UNIT,
    strike,
    structure,
    true_impact,
    true_weight,
)

pytestmark = pytest.mark.oracle

SIM = Walker(knee_torque=150.0, friction=1e6)
TORQUE = torch.tensor([150.0, 150.0, 150.0, 150.0]).double()
NOISE = torch.tensor([1e-3, 5e-3 / 6] * 5 + [0.0] * 3).double()


def true_model(substeps: int = 4) -> StrikingModel:
    """With the walker's own weights."""
    built = structure()
    weight = true_weight(built).numpy()
    free = TickModel(built, weight, 0.01, np.zeros(4), np.ones(4), substeps, STOPS)
    return StrikingModel(free, strike(), true_impact(built))


def walking(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Full states ``[count, 17]`` of which a third strikes soon, with knees near and at their
    stops; torques ``[count, 4]``, N m."""
    generator = torch.Generator().manual_seed(seed)

    def normal(n: int) -> Tensor:
        return torch.randn(count, n, generator=generator, dtype=torch.float64)

    state = torch.zeros(count, 17).double()
    q = torch.tensor(START).double() + 0.05 * normal(5)
    v = torch.tensor([1.0, 1.0, 0.0, -1.0, -1.0]).double() + normal(5)
    third = torch.arange(count) % 3
    strikes = torch.tensor([0.35, 0.25, 0.0, -0.4, 0.0]).double() + 0.03 * normal(5)
    # The swing foot is 2.5 mm above, and falls the ground.
    cosine = strikes[:, 0].cos() + strikes[:, 1].cos() - strikes[:, 3].cos() - 0.00625
    strikes[:, 4] = -cosine.clamp(-1, 1).acos()
    q = torch.where((third == 0).unsqueeze(-1), strikes, q)
    v[third == 0] += torch.tensor([1.0, 1.0, 0.0, 2.0, 1.0]).double()
    q[third > 0, 0] = q[third > 0, 1] + 0.01 * normal(1)[third > 0, 0].abs()
    locked = third == 2
    q[locked, 0], v[locked, 0] = q[locked, 1], v[locked, 1]
    _, height, *_ = foot_over(TORCH)(q.unbind(-1), v.unbind(-1))
    fine = (q[:, 0] >= q[:, 1]) & (q[:, 4] >= q[:, 3]) & (height > 1e-3)
    state[:, 0:10:2], state[:, 1:10:2] = q, v
    return state[fine], 20 * normal(4)[fine]


def seen(full: Tensor) -> Tensor:
    """Scaled readings ``[N, 13]``."""
    return SIM.observe(full) / torch.from_numpy(UNIT)


def scaled_action(torques: Tensor) -> Tensor:
    return torques / torch.from_numpy(ACTION_UNIT)


def data(count: int, seed: int, noise: float = 1.0) -> Transition:
    """Single ticks of the simulator."""
    state, torques = walking(count, seed)
    after = SIM.step(state, torques, torch.zeros(len(state), 0).double())
    generator = torch.Generator().manual_seed(seed)

    def read(full: Tensor) -> Tensor:
        error = torch.randn(len(full), 13, generator=generator, dtype=torch.float64)
        return seen(full) + noise * NOISE * error

    valid = after[:, 12] < 0.5
    dt = torch.tensor(0.01).double()
    return Transition(read(state), scaled_action(torques), read(after), dt, valid)


def learned(transition: Transition, **told: None) -> LearnedHybrid:
    built = structure()
    start = np.zeros((5, built.terms.count))
    model = TickModel(built, start, 0.01, np.zeros(4), np.ones(4), 1, STOPS)
    features = impact_terms(TOLD, built.lift)
    return learn_hybrid(model, strike(**told), features, transition, NOISE)


def test_the_true_weights_tick_as_the_simulator() -> None:
    model, (state, torques) = true_model(), walking(600, 0)
    after = SIM.step(state, torques, torch.zeros(len(state), 0).double())
    stands = after[:, 12] < 0.5
    found = struck_states(model, seen(state).numpy(), scaled_action(torques).unsqueeze(1).numpy())
    ticked, expected = found[stands, 1, :11], seen(after)[stands, :11].numpy()
    struck, knees = expected[:, 10] > 0, np.abs(expected[:, 0] - expected[:, 2]) < 1e-9
    assert struck.sum() > 30 and (knees & ~struck).sum() > 100
    np.testing.assert_allclose(ticked, expected, rtol=0, atol=1e-6)


def test_a_roll_out_completes_and_counts_its_strikes() -> None:
    """Falling through knee hits and strikes: time advances, nothing is lost."""
    state, _ = walking(60, 1)
    action = np.zeros((len(state), 60, 4))
    found = struck_states(true_model(1), seen(state).numpy(), action)
    assert np.isfinite(found).all()
    assert found[:, -1, 10].max() >= 2
    # Two sets of weights side by side.
    weight = true_model().free.weight
    both = struck_states(
        true_model(1),
        np.stack([seen(state).numpy()] * 2),
        np.stack([action] * 2),
        np.stack([weight, weight]),
    )
    np.testing.assert_array_equal(both[0], both[1])
    np.testing.assert_array_equal(both[0], found)


def test_events_are_found_in_readings() -> None:
    clean, noisy = data(600, 2, noise=0.0), data(600, 2)
    for each in (clean, noisy):
        free = free_ticks(each, STOPS, strike(), NOISE)
        struck = strike().happened(each.state, each.next_state)
        gaps = STOPS.gaps(clean.next_state)
        assert not bool((free & (struck | (gaps < 1e-9).any(-1))).any())
        assert int(free.sum()) > 100


def test_a_hybrid_model_is_learned_from_readings_with_noise() -> None:
    transition = data(2000, 3)
    found, test = learned(transition), data(300, 4, noise=0.0)
    assert found.strikes > 60 and found.free > 200
    start, action = test.state.numpy(), test.action.unsqueeze(1).numpy()
    wrong = (
        6 * (struck_states(found.model, start, action)[:, 1] - test.next_state.numpy())[:, 1:10:2]
    )
    valid, struck = test.valid.numpy(), strike().happened(test.state, test.next_state).numpy()
    size = np.sqrt(np.square(wrong).mean(-1))
    assert np.median(size[valid & ~struck]) < 0.01 and np.median(size[valid & struck]) < 0.05
    # Without stops, or without a jump at the strike, errors are large where these act.
    weak = replace(found.model, free=replace(found.model.free, stops=None))
    through = 6 * (struck_states(weak, start, action)[:, 1] - test.next_state.numpy())[:, 1:10:2]
    hit = valid & ~struck & (STOPS.gaps(test.next_state).abs() < 1e-9).any(-1).numpy()
    assert np.median(np.abs(through[hit]).max(-1)) > 20 * np.median(np.abs(wrong[hit]).max(-1))


def test_the_height_of_the_foot_is_learned() -> None:
    found = learned(data(2000, 3), height=None).model.strike.height
    at = structure().lift.at[[0, 2, 6, 8]] + 1
    np.testing.assert_allclose(found[at], [1, 1, -1, -1], rtol=0, atol=0.1)


def test_too_little_free_motion() -> None:
    few = data(60, 5)
    with pytest.raises(FitError, match=r"transitions: \d+ of \d+ are clear of stops and strikes"):
        learned(few)


def test_a_counter_that_changes_at_every_tick_is_none() -> None:
    given = data(200, 3)
    counting = given.next_state + torch.eye(13).double()[10] * given.state.new_tensor(5.0)
    with pytest.raises(FitError, match=r"told\.strike\.counter: it changes in \d+ of \d+ ticks"):
        learned(replace(given, next_state=counting))
