"""The unicycle against Lagrange's equations with multipliers, and how its episodes end."""

from __future__ import annotations

import math

import numba.core.config
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.func import grad, hessian, jacrev, jvp, vmap

from sims.base import JudgesStates, Outcome, Pictured, spec_index
from sims.conformance import check
from sims.rows import TORCH
from sims.sensing import Sensed
from sims.tasks import unicycle as of
from sims.tasks.integrate import runge_kutta_over
from sims.tasks.unicycle import Unicycle, derivative_over

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself


def _about(axis: int, angle: Tensor) -> Tensor:
    """The matrix of a rotation about x, y or z."""
    one, nothing = torch.ones_like(angle), torch.zeros_like(angle)
    a, b = [k for k in range(3) if k != axis]
    sign = -1 if axis == 1 else 1
    rows = [[nothing] * 3 for _ in range(3)]
    rows[axis][axis] = one
    rows[a][a] = rows[b][b] = angle.cos()
    rows[a][b], rows[b][a] = -sign * angle.sin(), sign * angle.sin()
    return torch.stack([torch.stack(row) for row in rows])


def _bodies(q: Tensor) -> tuple[tuple[Tensor, Tensor], ...]:
    """Rotation matrix and centre of mass of wheel, frame and disc; q: roll, yaw, wheel, pitch, disc
    and the contact's place."""
    roll, yaw, wheel, pitch, disc = q[:5]
    plane = _about(2, yaw) @ _about(0, -roll)
    centre = torch.cat([q[5:], torch.zeros(1).to(q)]) + of.RADIUS * plane[:, 2]
    frame = plane @ _about(1, pitch)
    return (
        (plane @ _about(1, wheel), centre),
        (frame, centre + of.TO_FRAME * frame[:, 2]),
        (frame @ _about(2, disc), centre + of.TO_DISC * frame[:, 2]),
    )


BODIES = (
    (of.WHEEL, (of.WHEEL_TURN, of.WHEEL_SPIN, of.WHEEL_TURN)),
    (of.FRAME, (of.FRAME_X, of.FRAME_Y, of.FRAME_Z)),
    (of.DISC, (of.DISC_TURN, of.DISC_TURN, of.DISC_SPIN)),
)


def _spin(turned: Tensor, change: Tensor) -> Tensor:
    """The angular velocity, in a body's own axes, from its rotation matrix and that one's rate."""
    w = turned.mT @ change
    return torch.stack([w[2, 1], w[0, 2], w[1, 0]])


def _energies(q: Tensor, dq: Tensor) -> tuple[Tensor, Tensor]:
    places, rates = jvp(_bodies, (q,), (dq,))[:2]
    kinetic = potential = torch.zeros(()).to(q)
    for (mass, moments), (turned, centre), (change, speed) in zip(
        BODIES, places, rates, strict=True
    ):
        turning = q.new_tensor(moments) * _spin(turned, change) ** 2
        kinetic = kinetic + 0.5 * (mass * (speed**2).sum() + turning.sum())
        potential = potential + mass * of.GRAVITY * centre[2]
    return kinetic, potential


def _lagrangian(q: Tensor, dq: Tensor) -> Tensor:
    kinetic, potential = _energies(q, dq)
    return kinetic - potential


def _energy(q: Tensor, dq: Tensor) -> Tensor:
    kinetic, potential = _energies(q, dq)
    return kinetic + potential


def _slip(q: Tensor, dq: Tensor) -> Tensor:
    """The velocity along the ground of the wheel's point of contact."""
    places, rates = jvp(_bodies, (q,), (dq,))[:2]
    (turned, centre), (change, speed) = places[0], rates[0]
    contact = torch.cat([q[5:], torch.zeros(1).to(q)])
    return (speed + change @ turned.mT @ (contact - centre))[:2]


def _accelerations(q: Tensor, dq: Tensor, u: Tensor) -> Tensor:
    """d^2 q / dt^2: M a + A' multipliers = h and A a + (dA/dt) dq = 0, where A dq is the slip."""
    mass, within = hessian(_lagrangian, 1)(q, dq), jacrev(_slip, 1)(q, dq)
    mixed = jacrev(grad(_lagrangian, 1), 0)(q, dq)
    nothing = torch.zeros(()).to(q)
    # The wheel's torque is between wheel and frame, the disc's between disc and frame.
    force = torch.stack([nothing, nothing, u[1], -u[1], u[0], nothing, nothing])
    h = force + grad(_lagrangian, 0)(q, dq) - mixed @ dq
    change = jvp(lambda q: _slip(q, dq), (q,), (dq,))[1]
    corner = torch.zeros(2, 2).to(q)
    whole = torch.cat([torch.cat([mass, within.mT], 1), torch.cat([within, corner], 1)])
    return torch.linalg.solve(whole, torch.cat([h, -change]))[:7]


def _draws(count: int) -> tuple[Tensor, Tensor]:
    """States ``[count, 12]`` up to a radian and 5 rad/s, actions ``[count, 2]``."""
    generator = torch.Generator().manual_seed(0)
    state = 2 * torch.rand(count, 12, generator=generator, dtype=torch.float64) - 1
    state[:, 1:10:2] *= 5
    state[:, [2, 4, 8]] *= 3
    return state, 30 * torch.randn(count, 2, generator=generator, dtype=torch.float64)


def _coordinates(state: Tensor) -> Tensor:
    return torch.cat([state[:, 0:10:2], state[:, 10:]], -1)


def _moved(state: Tensor, action: Tensor) -> Tensor:
    return torch.stack(derivative_over(TORCH)(state.unbind(-1), action.unbind(-1)), -1)


@pytest.mark.oracle
def test_lagranges_equations_with_multipliers() -> None:
    state, action = _draws(20)
    found = _moved(state, action)
    q, dq = _coordinates(state), _coordinates(found)
    assert torch.equal(dq[:, :5], state[:, 1:10:2])
    assert float(vmap(_slip)(q, dq).abs().max()) < 1e-12
    expected = vmap(_accelerations)(q, dq, action)[:, :5]
    torch.testing.assert_close(found[:, 1:10:2], expected, rtol=1e-9, atol=1e-9)


def _full_energy(state: Tensor) -> Tensor:
    nothing = torch.zeros(len(state), 2).double()
    return vmap(_energy)(_coordinates(state), _coordinates(_moved(state, nothing)))


@pytest.mark.oracle
def test_power_balance() -> None:
    state, action = _draws(20)
    change = jvp(_full_energy, (state,), (_moved(state, action),))[1]
    power = action[:, 0] * state[:, 9] + action[:, 1] * (state[:, 5] - state[:, 7])
    torch.testing.assert_close(change, power, rtol=1e-9, atol=1e-8)


@pytest.mark.oracle
def test_energy_is_conserved_in_a_fall() -> None:
    sim, nothing = Unicycle(), (torch.zeros(()).double(),) * 2
    move = runge_kutta_over(TORCH, derivative_over(TORCH), 12, sim.substeps)
    start = torch.tensor(
        [[0.1, 0, 0, 1, 0, 5, 0.1, 0, 0, 3, 0, 0], [0.02, 0, 0, 0, 0, 4.4] + [0] * 6]
    )
    rows = start.double().unbind(-1)
    for _ in range(3):
        rows = move(rows, nothing, sim.spec.dt)
    after = torch.stack(rows, -1)
    assert 0.5 < float(after[0, [0, 6]].abs().max()) < 1.4
    # Of the 300 J that a fall sets free.
    torch.testing.assert_close(_full_energy(after), _full_energy(start.double()), rtol=0, atol=3e-4)


def test_equilibria() -> None:
    nothing = torch.zeros(1, 2).double()
    rolling = torch.zeros(1, 12).double()
    rolling[:, [4, 8, 2]] = torch.tensor([3.0, 1.0, 0.5]).double()
    rolling[:, 5] = 4.4
    found = _moved(rolling, nothing)
    assert float(found[:, 1:10:2].abs().max()) == 0
    assert float(found[0, 10:].norm()) == pytest.approx(of.RADIUS * 4.4)
    for tilt in (0, 6):
        leaning = torch.zeros(1, 12).double()
        leaning[:, tilt] = 0.1
        assert float(_moved(leaning, nothing)[0, tilt + 1]) > 0.1


def test_a_coin_that_rolls_on_the_spot_leans_towards_its_curve() -> None:
    # Without frame and disc, of a disc on edge: yaw rate w at wheel speed s bends it outwards,
    # r^2 m + C times w s, against gravity m g r sin(roll), to the first order in roll.
    state = torch.zeros(1, 12).double()
    state[:, 3], state[:, 5] = 1.0, 10.0
    found = float(_moved(state, torch.zeros(1, 2).double())[0, 1])
    mass = of.WHEEL + of.FRAME + of.DISC
    moment = of.FRAME * of.TO_FRAME + of.DISC * of.TO_DISC
    assert found < 0
    push = of.WHEEL_SPIN * 10.0 + of.RADIUS * 10.0 * (mass * of.RADIUS + moment)
    second = of.FRAME * of.TO_FRAME**2 + of.DISC * of.TO_DISC**2
    inertia = (
        *(of.WHEEL_TURN, of.FRAME_X, of.DISC_TURN, second),
        *(mass * of.RADIUS**2, 2 * of.RADIUS * moment),
    )
    assert found == pytest.approx(-push / sum(inertia))


@pytest.mark.oracle
def test_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    check(Unicycle(), batches=((), (1,), (5,)), steps=2, compiled=False)
    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    check(Unicycle(), batches=((5,),), steps=2)


@pytest.mark.long
def test_conforms_compiled() -> None:
    # Long enough to fall, and to lie still then.
    check(Unicycle(), batches=((5,),), steps=20)


def _ride(sim: Unicycle, size: float, ticks: int, batch: int) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    draws = torch.rand(batch, 12, generator=generator, dtype=torch.float64)
    states, high = [sim.initial(draws)], torch.tensor([10.0, 50.0]).double()
    for _ in range(ticks):
        action = 2 * torch.rand(batch, 2, generator=generator, dtype=torch.float64) - 1
        states.append(sim.step(states[-1], size * high * action, torch.zeros(batch, 0).double()))
    return torch.stack(states, 1)


def test_a_ride_ends_where_it_is_judged_to() -> None:
    sim = Unicycle(time_limit=0.6)
    states = _ride(sim, 0.3, 4, 100)
    outcome = sim.outcome(states)
    failed = (outcome == int(Outcome.FAILED)).any(1)
    assert 5 < int(failed.sum()) < 95
    assert torch.equal(sim.judge(sim.observe(states)), ~failed)
    assert torch.equal(outcome[:, -1] == int(Outcome.SUCCEEDED), ~failed)
    assert not bool(sim.judge(sim.observe(states)[:, :-1]).any())
    found = sim.measures(states[:, 0], states[:, -1], torch.ones(100).double())
    tilt = states[:, :, [0, 6]].abs().amax((1, 2))
    assert torch.equal(found["largest_tilt_rad"], tilt)
    assert torch.equal(found["largest_tilt_rad"] > math.pi / 2, failed)
    assert 0.01 < float(found["distance_m"].mean()) < 2
    assert sim.outcome(states[0, 0] * math.nan) == int(Outcome.FAILED)


def test_ten_seconds_are_67_ticks() -> None:
    sim = Unicycle()
    still = torch.zeros(68, 14).double()
    still[:, 12] = torch.arange(68)
    assert sim.outcome(still).tolist() == [int(Outcome.RUNNING)] * 67 + [int(Outcome.SUCCEEDED)]
    assert bool(sim.judge(still[:, :10])) and not bool(sim.judge(still[:67, :10]))


def test_the_fallen_lie_still() -> None:
    sim = Unicycle()
    states = _ride(sim, 1.0, 12, 5)
    assert bool((sim.outcome(states[:, -1]) == int(Outcome.FAILED)).all())
    assert bool(states.isfinite().all())
    pushed = sim.step(states[:, -1], torch.full((5, 2), 9.0).double(), torch.zeros(5, 0).double())
    assert torch.equal(pushed[:, :12], states[:, -1, :12])


def test_starts_and_sensors() -> None:
    sim = Unicycle()
    draws = torch.rand(20_000, 12, generator=torch.Generator().manual_seed(0)).double()
    start = sim.initial(draws)
    deviation = torch.tensor([0.02] * 10 + [0.1] * 2).double()
    torch.testing.assert_close(start[:, :12].std(0), deviation, rtol=0.03, atol=0)
    sensed = Sensed(sim, {"roll": 0.003})
    assert isinstance(sensed, JudgesStates) and isinstance(sensed, Pictured)


@pytest.mark.parametrize(("dt", "limit"), [(0.0, 10.0), (math.nan, 10.0), (0.15, 0.1)])
def test_impossible_arguments(dt: float, limit: float) -> None:
    with pytest.raises(ValueError, match=r"(dt|time_limit)=.*: expected"):
        Unicycle(dt, limit)


def test_pictures() -> None:
    sim = Unicycle()
    trail = _ride(sim, 0.2, 5, 1)[0]
    for part in (trail[:1], trail, trail.float()):
        picture = sim.frame(part)
        assert picture.shape == (270, 480, 3) and picture.dtype == np.uint8
    fallen = trail[:1] + 0
    fallen[0, 0] = 1.5
    # Less of it is high up.
    high = [(sim.frame(part)[60:120].sum(-1) < 500).sum() for part in (trail[:1], fallen)]
    assert high[1] < high[0]


@pytest.mark.oracle
def test_a_regulator_about_a_cruise_rides_for_ten_seconds() -> None:
    sim = Unicycle()
    sensed = Sensed(sim, {quantity.name: 0.01 for quantity in sim.spec.state})
    # The disc's rate is left out: at rest nothing changes the angular momentum about the vertical.
    names = ("roll", "roll_rate", "yaw_rate", "wheel_rate", "pitch", "pitch_rate")
    index = spec_index(sim.spec, names)
    cruise = torch.zeros(16).double()
    cruise[5] = 1.0 / of.RADIUS
    none = torch.zeros(0).double()
    slope = jacrev(lambda x: sim.observe(sim.step(x[:14], x[14:], none))[index])(cruise)
    a, b = slope[:, index], slope[:, 14:]
    price = torch.tensor([10, 0.1, 0.1, 0.01, 10, 0.1], dtype=torch.float64).diag()
    effort = torch.tensor([10.0**-2, 50.0**-2], dtype=torch.float64).diag()
    ahead, gain = price, torch.zeros(2, 6).double()
    for _ in range(300):  # of Riccati's recursion
        gain = torch.linalg.solve(effort + b.mT @ ahead @ b, b.mT @ ahead @ a)
        ahead = price + a.mT @ ahead @ (a - b @ gain)
    generator = torch.Generator().manual_seed(0)

    def uniforms(count: int) -> Tensor:
        return torch.rand(50, count, generator=generator, dtype=torch.float64)

    states = [sensed.initial(uniforms(sensed.spec.reset_dim))]
    high = torch.tensor([10.0, 50.0]).double()
    for _ in range(67):
        error = sensed.observe(states[-1])[:, index] - cruise[index]
        action = (-error @ gain.mT).clamp(-high, high)
        states.append(sensed.step(states[-1], action, uniforms(sensed.spec.disturbance_dim)))
    assert float((sensed.outcome(states[-1]) == int(Outcome.SUCCEEDED)).double().mean()) > 0.95
    found = sensed.measures(states[0], states[-1], torch.full((50,), 10.05).double())
    assert 5 < float(found["distance_m"].mean()) < 10
