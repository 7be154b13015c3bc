"""Ticks across a guard: closed forms, finite differences, and beliefs beside particles."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.derivatives import StateFunction, rowwise_jacobian
from edtorch.transform import (
    ConstantNoise,
    Cubature,
    FirstOrder,
    MonteCarlo,
    Transform,
)
from edtorch.transform.guarded import Guarded, HeldLoop, crossing_probability, saltation
from edtorch.types import Belief
from sims.rows import TORCH
from sims.tasks.stop_pendulum import LOW, StopPendulum
from tests.guards import GRAVITY, ball, cart, rod
from tests.systems import f64, normal

SECONDS, LEFT = 0.05, 0.7
STILL = ConstantNoise(torch.zeros(2, 2).double())
FREE = f64([[0.4, -1.0, 0.5], [LOW + 0.3, -1.0, 2.0]])
HITS = f64([[LOW + 0.05, -2.0, 0.0], [LOW + 0.01, -0.5, -1.0], [LOW + 0.12, -3.0, 3.0]])


def _central(function: StateFunction, state: Tensor) -> Tensor:
    step = 1e-6
    moves = step * torch.eye(state.shape[-1]).double()
    each = [(function(state + move) - function(state - move)) / (2 * step) for move in moves]
    return torch.stack(each, dim=-1)


def test_a_ball_bounces_as_it_does() -> None:
    height, speed = 0.03, -1.0
    until = (speed + math.sqrt(speed**2 + 2 * GRAVITY * height)) / GRAVITY
    left, up = SECONDS - until, LEFT * (GRAVITY * until - speed)
    expected = f64([left * up - GRAVITY * left**2 / 2, up - GRAVITY * left])
    tick = Guarded(ball(LEFT), SECONDS)
    assert tick.until(f64([height, speed])).item() == pytest.approx(until, abs=1e-14)
    assert torch.allclose(tick(f64([height, speed])), expected, atol=1e-13)


def test_saltation_of_a_bounce() -> None:
    speed = f64([-0.5, -3.0])
    found = saltation(ball(LEFT), torch.stack([torch.zeros(2).double(), speed], dim=-1))
    for S, v in zip(found, speed.tolist(), strict=True):
        # Dg = diag(1, -e), f_- = (v, -g), f_+ = (-e v, -g), grad h = (1, 0).
        expected = f64([[-LEFT, 0.0], [-(1 + LEFT) * GRAVITY / v, -LEFT]])
        assert torch.allclose(S, expected, atol=1e-12)


def test_nothing_is_left_of_deviations_at_a_stop() -> None:
    found = saltation(rod(), f64([LOW, -2.0, 0.5]))
    assert torch.allclose(found, torch.diag(f64([0.0, 0.0, 1.0])), atol=1e-14)


@pytest.mark.parametrize("states", [FREE, HITS, torch.cat([FREE, HITS])])
def test_the_jacobian_is_that_of_the_tick(states: Tensor) -> None:
    tick, state = Guarded(rod(), SECONDS), states.expand(2, *states.shape)
    assert bool(tick.crosses(HITS).all()) and not bool(tick.crosses(FREE).any())
    found = tick.jacobian(state)
    assert torch.allclose(found, rowwise_jacobian(tick, state), atol=1e-9)
    assert torch.allclose(found, _central(tick, state), atol=1e-6)


def test_the_jacobian_of_a_bounce_has_derivatives() -> None:
    tick = Guarded(ball(LEFT), SECONDS)
    state = f64([[0.03, -1.0], [0.02, -2.0], [1.0, 0.3]]).requires_grad_()
    assert torch.autograd.gradcheck(tick.jacobian, (state,), atol=1e-6)


def test_a_rod_hits_its_stop_as_in_the_simulator() -> None:
    motion, tick = StopPendulum().motion(TORCH), Guarded(rod(), SECONDS)
    for state in torch.cat([FREE, HITS]):
        angle, rate, torque = state.unbind(-1)
        expected = torch.stack(list(motion((angle, rate), (torque,), SECONDS)))
        assert torch.allclose(tick(state)[:2], expected, atol=1e-6)


def test_what_rests_on_a_stop_stays_or_leaves() -> None:
    tick, rest = Guarded(rod(), SECONDS), f64([[LOW, 0.0, 0.0], [LOW, 0.0, 3.0]])
    after = tick(rest)
    assert torch.equal(after[0], rest[0])
    assert after[1, 0] > LOW and after[1, 1] > 0
    assert torch.isfinite(tick.jacobian(rest)).all()
    assert torch.equal(tick.jacobian(rest)[0, 1], torch.zeros(3).double())


def test_a_held_action_acts_through_the_event() -> None:
    gain = f64([[0.7, -0.4]])
    loop = HeldLoop(Guarded(rod(), SECONDS), lambda s: s @ gain.mT)
    state = torch.cat([FREE, HITS])[:, :2]
    assert torch.allclose(loop.jacobian(state), _central(loop, state), atol=1e-6)
    assert torch.allclose(loop.jacobian(state), rowwise_jacobian(loop, state), atol=1e-9)


def test_a_cart_at_a_wall_has_two_speeds() -> None:
    """Of normal position and known speed v: at rest with probability p, so that the variance of the
    speed is v^2 p (1 - p)."""
    speed, deviation = -2.0, 0.04
    event = cart(speed)
    for start in (0.06, 0.1, 0.14):
        belief = Belief(f64([start, speed]), torch.diag(f64([deviation**2, 0.0])))
        gone = Belief(f64([start + SECONDS * speed, speed]), belief.cov)
        p = 0.5 * math.erfc((start + SECONDS * speed) / deviation / math.sqrt(2))
        assert crossing_probability(gone, event).item() == pytest.approx(p, abs=1e-12)
        samples = MonteCarlo(20_000, 2, torch.Generator().manual_seed(0))
        moved = samples.move(belief, Guarded(event, SECONDS, 1), STILL)
        assert moved.cov[1, 1].item() == pytest.approx(speed**2 * p * (1 - p), rel=0.05)


def test_a_known_state_crosses_or_does_not() -> None:
    nothing = torch.zeros(2, 2, 2).double()
    known = Belief(f64([[0.1, -1.0], [-0.1, -1.0]]), nothing)
    assert crossing_probability(known, ball(LEFT)).tolist() == [0.0, 1.0]


def _course(transform: Transform, ticks: int) -> list[Belief]:
    """Of a ball that falls from 0.8 m and bounces in the eighth and the ninth tick."""
    belief, found = Belief(f64([0.8, 0.0]), torch.diag(f64([0.02, 0.05]) ** 2)), list[Belief]()
    for _ in range(ticks):
        belief = transform.move(belief, Guarded(ball(LEFT), SECONDS, 1), STILL)
        found.append(belief)
    return found


@pytest.mark.oracle
def test_points_know_the_tick_of_the_bounce_and_saltation_what_follows() -> None:
    """Particles, whose belief is not made normal after each tick, have two speeds where some have
    bounced and some have not, and one again when all have."""
    draws = normal(torch.Generator().manual_seed(0), 20_000, 2)
    state = f64([0.8, 0.0]) + f64([0.02, 0.05]) * draws
    tick, speeds = Guarded(ball(LEFT), SECONDS, 1), list[float]()
    for _ in range(12):
        state = tick(state)
        speeds.append(state[:, 1].std().item())
    first, points = _course(FirstOrder(), 12), _course(Cubature(), 12)

    def deviation(beliefs: list[Belief], place: int) -> float:
        return beliefs[place].cov[1, 1].sqrt().item()

    assert speeds[7] > 2.5 and speeds[11] < 0.11
    assert deviation(points, 7) == pytest.approx(speeds[7], rel=0.1)
    assert deviation(first, 7) < 0.02 * speeds[7]
    assert deviation(first, 11) == pytest.approx(speeds[11], rel=0.02)
    assert deviation(points, 11) > 4 * speeds[11]


def test_saltation_carries_the_correlation_across_a_bounce() -> None:
    """The derivative of the mean after the bounce is that of the flight in closed form."""
    mean = f64([0.8, 0.0])

    def after(start: Tensor) -> Tensor:
        height, speed = start.unbind()
        until = (speed + (speed**2 + 2 * GRAVITY * height).sqrt()) / GRAVITY
        left, up = 12 * SECONDS - until, LEFT * (GRAVITY * until - speed)
        return torch.stack([left * up - GRAVITY * left**2 / 2, up - GRAVITY * left])

    exact = rowwise_jacobian(after, mean)
    last = _course(FirstOrder(), 12)[-1]
    assert torch.allclose(last.mean, after(mean), atol=1e-12)
    start = torch.diag(f64([0.02, 0.05]) ** 2)
    assert torch.allclose(last.cov, exact @ start @ exact.mT, rtol=1e-9)
