"""The bicycle's step against published numbers, an independent program, and itself mirrored."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from sims.base import Outcome, spec_index
from sims.bicycle import (
    HANDLEBAR_FIRST,
    RANDLOV,
    Bicycle,
    Physics,
    angle_to_goal,
    explicit_euler,
    semi_implicit,
    step,
)
from sims.bicycle.displacement import displacement

CASES = json.loads((Path(__file__).parent / "bicycle_vectors.json").read_text())
MIRROR = torch.tensor([-1, -1, -1, -1, -1, -1, -1, 1, -1, 1], dtype=torch.float64)

CLOSED_LOOP = {
    100: "-0.557174966264 0.175854148563 -0.187154746592 -0.0510894502873 0.911448722459"
    " -0.284409169209 0.196381366186 3.6967048599 -0.115073982922 2.63129622209",
    1000: "-0.00105205429233 0.000631789108307 -0.000700671851092 -0.000470636347531"
    " -0.00324698986451 -1.57422690952 24.3413050225 7.41206251511 23.2397774274 7.41584141147",
    5000: "-2.81790652979e-06 0.000715294925156 1.05538152855e-05 0.000349509860831"
    " -0.0649004679061 -1.57840736102 135.44929098 6.58002028832 134.347790028 6.58840401165",
    35765: "8.11462842157e-06 -0.000179303545202 -9.53646607165e-06 -0.000841697889188"
    " 0.0103367907488 -1.57840647859 990.007874041 0.0760454102393 988.906373105"
    " 0.084428161396",
}


V, G, D_CM, C, H, L = 10 / 3.6, 9.82, 0.30, 0.66, 0.94, 1.11
M_C, M_D, M_P, R, DT = 15.0, 1.7, 60.0, 0.34, 0.01
M = M_C + M_P
SIGMA_DOT = V / R
I_B = 13 / 3 * M_C * H**2 + M_P * (H + D_CM) ** 2
I_DC, I_DV, I_DL = M_D * R**2, 1.5 * M_D * R**2, 0.5 * M_D * R**2
THETA_MAX = 1.3963


def _sign(x: float) -> int:
    return (x > 0) - (x < 0)


def plain_step(
    state: list[float], action: tuple[float, float], w: float, *, explicit: bool = False
) -> list[float]:
    """One step of 0.01 s, written out in plain floats as published, signs and quirks included."""
    theta, theta_dot, omega, omega_dot, _, psi, xf, yf, xb, yb = state
    torque, d = action
    k_f, k_b = abs(math.sin(theta)) / L, abs(math.tan(theta)) / L
    k_cm = 0.0 if theta == 0 else 1 / math.sqrt((L - C) ** 2 + L**2 / math.tan(theta) ** 2)
    phi = omega + math.atan((d + w) / H)
    turning = _sign(theta) * V**2 * (M_D * R * (k_f + k_b) + M * H * k_cm)
    omega_ddot = (
        H * M * G * math.sin(phi) - math.cos(phi) * (I_DC * SIGMA_DOT * theta_dot + turning)
    ) / I_B
    theta_ddot = (torque - I_DV * omega_dot * SIGMA_DOT) / I_DL
    if explicit:
        omega += DT * omega_dot
        theta += DT * theta_dot
        omega_dot += DT * omega_ddot
        theta_dot += DT * theta_ddot
        if abs(theta) > THETA_MAX:
            theta_dot = 0.0
    else:
        omega_dot += DT * omega_ddot
        omega += DT * omega_dot
        theta_dot += DT * theta_ddot
        theta += DT * theta_dot
    theta = max(-THETA_MAX, min(THETA_MAX, theta))

    s = V * DT
    a = psi + theta + _sign(psi + theta) * math.asin(min(1.0, s * k_f / 2))
    xf, yf = xf - s * math.sin(a), yf + s * math.cos(a)
    a = psi + _sign(psi) * math.asin(min(1.0, s * k_b / 2))
    xb, yb = xb - s * math.sin(a), yb + s * math.cos(a)
    n = math.hypot(xf - xb, yf - yb)
    if abs(n - L) > 0.01:
        xb, yb = xb + (xb - xf) * (L - n) / n, yb + (yb - yf) * (L - n) / n
    psi = math.atan2(xb - xf, yf - yb)
    return [theta, theta_dot, omega, omega_dot, omega_ddot, psi, xf, yf, xb, yb]


def random_state(uniform: Callable[[float, float], float]) -> list[float]:
    """A state anywhere, from ``uniform(low, high)``; tyres up to 2 cm from where they belong."""
    psi = uniform(-math.pi, math.pi)
    xb, yb = uniform(-500, 1500), uniform(-500, 500)
    length = L + uniform(-0.02, 0.02)
    return [
        uniform(-THETA_MAX, THETA_MAX),
        uniform(-20, 20),
        uniform(-1.5, 1.5),
        uniform(-5, 5),
        0.0,
        psi,
        xb - length * math.sin(psi),
        yb + length * math.cos(psi),
        xb,
        yb,
    ]


def tensor(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def error(got: Tensor, wanted: Tensor) -> float:
    return float(((got - wanted).abs() / (1 + wanted.abs())).max())


def random_batch(count: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """States, actions and disturbances, a little wider than a ride has them."""
    draw = random.Random(seed)
    states = [random_state(draw.uniform) for _ in range(count)]
    actions = [(draw.uniform(-3, 3), draw.uniform(-0.03, 0.03)) for _ in range(count)]
    return (
        torch.tensor(states, dtype=torch.float64),
        torch.tensor(actions, dtype=torch.float64),
        tensor(*(draw.uniform(-0.02, 0.02) for _ in range(count))),
    )


@pytest.mark.parametrize("case", range(len(CASES)))
def test_published_vectors(case: int) -> None:
    given = CASES[case]
    torque, d, w = given["T"], given["d"], given["w"]
    start = tensor(*given["s"])
    once = step(start, tensor(torque, d), tensor(w)[0])
    assert error(once, tensor(*given["out"]["1"])) < 1e-9
    state = start
    for k in range(100):
        action = tensor(torque * math.cos(0.1 * k), d * math.cos(0.07 * k))
        state = step(state, action, tensor(0.02 * math.sin(k))[0])
    assert error(state, tensor(*given["out"]["100"])) < 1e-9


@pytest.mark.long
def test_closed_loop_to_the_goal_by_names() -> None:
    sim = Bicycle(start_heading_low=0.0, start_heading_high=0.0, time_limit=600.0)
    order = spec_index(sim.spec, HANDLEBAR_FIRST)
    weights = tensor(-1.7, -1.0, 1.7, 1.1, -2.0, -1.7, -0.4, 1.9, 0.7, 1.8).reshape(2, 5).T
    weights = weights / tensor(0.5, 2, 0.15, 0.2, math.pi)[:, None]
    state = sim.initial(torch.zeros(1, 1, dtype=torch.float64))
    with torch.inference_mode():
        for k in range(35765):
            assert k % 1000 or int(sim.outcome(state)) == Outcome.RUNNING
            action = (sim.observe(state)[:, order] @ weights).clamp(-1, 1) * tensor(2, 0.02)
            state = step(state, action, tensor(0.02 * math.sin(k)))
            if k + 1 in CLOSED_LOOP:
                wanted = tensor(*map(float, CLOSED_LOOP[k + 1].split()))
                assert error(state[0], wanted) < 1e-9, k + 1
    assert int(sim.outcome(state)) == Outcome.SUCCEEDED


@pytest.mark.parametrize("explicit", [False, True])
def test_any_state_against_plain_python(explicit: bool) -> None:
    states, actions, w = random_batch(2000)
    integrate = explicit_euler if explicit else semi_implicit
    got = step(states, actions, w, integrate=integrate)
    for k in range(len(states)):
        d = (float(actions[k, 0]), float(actions[k, 1]))
        wanted = plain_step(states[k].tolist(), d, float(w[k]), explicit=explicit)
        assert error(got[k], tensor(*wanted)) < 1e-9, states[k]


@pytest.mark.parametrize("psi", [0.0, math.pi / 2, -math.pi / 2, math.pi])
@pytest.mark.parametrize("theta", [0.0, 0.3, -0.3])
def test_headings_on_the_axes_against_plain_python(psi: float, theta: float) -> None:
    x, y = round(math.sin(psi)) * 1.11, round(math.cos(psi)) * 1.11
    state = [theta, 0.0, 0.0, 0.0, 0.0, psi, -x, y, 0.0, 0.0]
    got = step(tensor(*state), tensor(0.5, 0.01), tensor(0.0)[0])
    assert error(got, tensor(*plain_step(state, (0.5, 0.01), 0.0))) < 1e-9


def test_mirrored_rides_mirror() -> None:
    states, actions, w = random_batch(500)
    mirrored = step(states * MIRROR, -actions, -w)
    assert error(mirrored, step(states, actions, w) * MIRROR) < 1e-12


def test_due_south_is_plus_pi_also_mirrored() -> None:
    # The heading lies in (-pi, pi], as in the C program: the one thing that has no mirror image.
    state = tensor(0, 0, 0, 0, 0, math.pi, 0, -1.11, 0, 0)
    assert float(step(state, tensor(0, 0), tensor(0)[0])[5]) == math.pi
    mirrored = state * MIRROR
    assert float(step(mirrored, tensor(0, 0), tensor(0)[0])[5]) == math.pi


@pytest.mark.parametrize("integrate", [semi_implicit, explicit_euler])
def test_same_digits_for_any_batch(integrate) -> None:
    states, actions, w = random_batch(70)
    alone = [step(states[k : k + 1], actions[k : k + 1], w[k : k + 1], integrate=integrate)
             for k in range(70)]  # fmt: skip
    bare = [step(states[k], actions[k], w[k], integrate=integrate) for k in range(70)]
    for size in range(1, 71):
        together = step(states[:size], actions[:size], w[:size], integrate=integrate)
        assert torch.equal(together, torch.cat(alone[:size])), size
        assert torch.equal(together, torch.stack(bare[:size])), size
        assert torch.equal(
            angle_to_goal(together), torch.cat([angle_to_goal(s) for s in alone[:size]])
        )
    grid = step(states.reshape(7, 10, 10), actions.reshape(7, 10, 2), w.reshape(7, 10))
    strided = step(states.T.contiguous().T, actions.T.contiguous().T, w)
    wanted = step(states, actions, w)
    assert torch.equal(grid.reshape(70, 10), wanted)
    assert torch.equal(strided, wanted)


def test_handlebar_stop() -> None:
    state = tensor(1.39, 5, 0, 0, 0, 0, 0, 1.11, 0, 0)
    wound = step(state, tensor(2, 0), tensor(0)[0])
    stopped = step(state, tensor(2, 0), tensor(0)[0], integrate=explicit_euler)
    assert float(wound[0]) == float(stopped[0]) == 1.3963
    assert float(wound[1]) > 5 and float(stopped[1]) == 0


def test_explicit_euler_uses_old_rates() -> None:
    state = tensor(0.1, 0.2, 0.05, 0.3, 0, 0, 0, 1.11, 0, 0)
    new = step(state, tensor(1, 0.01), tensor(0.01)[0], integrate=explicit_euler)
    assert float(new[0]) == pytest.approx(0.1 + 0.01 * 0.2, abs=1e-15)
    assert float(new[2]) == pytest.approx(0.05 + 0.01 * 0.3, abs=1e-15)


def test_no_clipping() -> None:
    start = tensor(0, 0, 0, 0, 0, 0, 0, 1.11, 0, 0)
    one, ten = (step(start, tensor(torque, 0), tensor(0)[0])[1] for torque in (1.0, 10.0))
    assert float(ten) == pytest.approx(10 * float(one), rel=1e-12)


def test_vmap_agrees() -> None:
    states, actions, w = random_batch(20)
    mapped = torch.func.vmap(step)(states, actions, w)
    assert error(mapped, step(states, actions, w)) < 1e-14


def test_jacobian_against_finite_differences() -> None:
    states, actions, w = random_batch(20, seed=1)
    # Where nothing happens: the tyres' repair, the stop and signs are steps, without derivative.
    states[:, 6:8] = states[:, 8:10] + 1.11 * torch.stack(
        (-states[:, 5].sin(), states[:, 5].cos()), -1
    )
    states[:, 0] *= 0.5
    states[:, 1] *= 0.1

    def forward(state: Tensor, action: Tensor, w: Tensor) -> Tensor:
        return step(state, action, w)

    jacobian = torch.func.vmap(torch.func.jacrev(forward, (0, 1)))(states, actions, w)
    for which, (matrix, size) in enumerate(zip(jacobian, (10, 2), strict=True)):
        for k in range(size):
            shift = torch.zeros(size, dtype=torch.float64)
            shift[k] = 1e-6
            ends = []
            for sign in (1, -1):
                moved = [states, actions]
                moved[which] = moved[which] + sign * shift
                ends.append(step(moved[0], moved[1], w))
            slope = ends[0] - ends[1]
            slope[:, 5] = torch.remainder(slope[:, 5] + 3, 2 * math.pi) - 3
            assert error(matrix[..., k], slope / 2e-6) < 1e-6


@pytest.mark.parametrize("psi", [0.0, math.pi / 2, -math.pi / 2, math.pi])
def test_jacobian_is_finite_upright_and_straight(psi: float) -> None:
    x, y = -round(math.sin(psi)) * 1.11, round(math.cos(psi)) * 1.11
    state = tensor(0, 0, 0, 0, 0, psi, x, y, 0, 0)
    zero = tensor(0)[0]
    for integrate in (semi_implicit, explicit_euler):

        def forward(state: Tensor, integrate=integrate) -> Tensor:
            return step(state, tensor(0, 0), zero, integrate=integrate)

        matrix = torch.func.jacrev(forward)(state)
        assert bool(matrix.isfinite().all())
        # Steering left throws the bicycle to the right, also from dead straight.
        assert float(matrix[4, 0]) < -1
    assert bool(torch.func.jacrev(angle_to_goal)(state).isfinite().all())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_compiles_in_one_graph(dtype: torch.dtype) -> None:
    states, actions, w = (part.to(dtype) for part in random_batch(6))
    compiled = torch.compile(step, fullgraph=True, backend="eager")
    got = compiled(states, actions, w)
    assert got.dtype == dtype
    assert torch.equal(got, step(states, actions, w))


def test_float32_is_close() -> None:
    states, actions, w = random_batch(100)
    states[:, 6:] -= states[:, [8, 9, 8, 9]].round()
    got = step(states.float(), actions.float(), w.float())
    assert got.dtype == torch.float32
    wrapped = got.double() - step(states, actions, w)
    wrapped[:, 5] = torch.remainder(wrapped[:, 5] + 3, 2 * math.pi) - 3
    assert float(wrapped.abs().max()) < 1e-4


def test_constants_of_its_own_for_every_element() -> None:
    states, actions, w = random_batch(9)
    mass, stop = torch.linspace(40, 90, 9).double(), torch.linspace(0.5, 1.3, 9).double()
    lengths = torch.linspace(1.0, 1.2, 9).double()
    together = step(
        states, actions, w, physics=replace(RANDLOV, M_p=mass, theta_max=stop, l=lengths)
    )
    for k in range(9):
        own = replace(RANDLOV, M_p=float(mass[k]), theta_max=float(stop[k]), l=float(lengths[k]))
        assert error(together[k], step(states[k], actions[k], w[k], physics=own)) < 1e-13


def test_displacement_is_read_back() -> None:
    state = tensor(0.1, 0.5, 0.05, -0.2, 0, 1, 0, 1, 0, 0)
    trail, hung = [state], []
    for k in range(10):
        d, w = 0.02 * math.sin(k), 0.01 * math.cos(3 * k)
        trail.append(step(trail[-1], tensor(0.3, d), tensor(w)[0]))
        hung.append(d + w)
    assert torch.allclose(displacement(torch.stack(trail)), tensor(*hung), atol=1e-12)


def test_refuses_constants_that_no_bicycle_has() -> None:
    with pytest.raises(ValueError, match="v=-1: expected a finite number above 0"):
        Physics(v=-1)
