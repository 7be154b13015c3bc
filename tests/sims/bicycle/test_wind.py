"""Gusts: how often, how long, how strong, and which way they throw a bicycle."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from sims.bicycle import Bicycle
from sims.bicycle.displacement import displacement
from sims.bicycle.physics import RANDLOV, step
from sims.bicycle.wind import Gusts


def f64(*numbers: float) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def blown(gusts: Gusts, rows: int, steps: int) -> Tensor:
    """Forces ``[steps, rows]``."""
    generator = torch.Generator().manual_seed(0)
    force = left = torch.zeros(rows, dtype=torch.float64)
    forces = []
    for _ in range(steps):
        uniforms = torch.rand(2, rows, generator=generator, dtype=torch.float64)
        force, left = gusts.blow(force, left, uniforms)
        forces.append(force)
    return torch.stack(forces)


def test_how_often_how_long_how_strong() -> None:
    rows, steps = 400, 10_000
    forces = blown(Gusts(10.0, 1.0, 5.0, 0.01), rows, steps)
    before = torch.cat([torch.zeros(1, rows).double(), forces[:-1]])
    begins = (forces != before) & (forces != 0)
    # 20 beginnings in 100 s each, their number having a variance of about (4/5)^2 of its mean.
    count = float(begins.sum()) / rows
    assert count == pytest.approx(20, abs=4 * 4 / math.sqrt(rows) + 0.2)
    sizes = forces[begins]
    assert float(sizes.mean()) == pytest.approx(0, abs=0.5)
    assert float(sizes.std()) == pytest.approx(10, rel=0.03)
    # All but those cut off at the end last a second.
    assert float((forces != 0).sum()) == pytest.approx(100 * float(begins.sum()), rel=0.01)
    first = begins[:, 0].nonzero()[0, 0]
    assert torch.equal(forces[first : first + 100, 0], forces[first, 0].expand(100))
    assert forces[first + 100, 0] != forces[first, 0]


def test_gusts_without_a_break() -> None:
    gusts = Gusts(10.0, 0.5, 0.5, 0.1)
    assert gusts.chance == 1
    forces = blown(gusts, 3, 20)
    assert bool((forces != 0).all())
    assert bool((forces.reshape(4, 5, 3).diff(dim=1) == 0).all())
    assert bool((forces[::5].diff(dim=0) != 0).all())


def lean_acceleration(lean: float, force: float) -> float:
    state = f64(0, 0, lean, 0, 0, 0, 0, 1.11, 0, 0)
    return float(step(state, f64(0, 0), f64(0)[0], side_force=f64(force)[0])[4])


def test_a_constant_force_is_balanced_by_leaning_into_it() -> None:
    # The resultant of weight M g and force F goes through the line of the tyres.
    M = float(RANDLOV.M)
    for force in (10.0, -25.0):
        assert lean_acceleration(-math.atan(force / (M * RANDLOV.g)), force) == pytest.approx(
            0, abs=1e-14
        )
    assert lean_acceleration(0.0, 10.0) > 0  # from the right: it falls to the left


def test_the_moment_is_the_virtual_work() -> None:
    # U = M g y - F x at the centre of mass x = h sin(lean) to the left, y = h cos(lean) up.
    p, force, shift = RANDLOV, 7.0, 1e-6

    def energy(lean: float) -> float:
        x, y = p.h * math.sin(lean), p.h * math.cos(lean)
        return float(p.M * p.g * y - force * x)

    for lean in (-0.15, 0.0, 0.1):
        moment = -(energy(lean + shift) - energy(lean - shift)) / (2 * shift)
        assert lean_acceleration(lean, force) * float(p.I_B) == pytest.approx(moment, abs=1e-4)


def test_a_still_day_is_the_plain_bicycle() -> None:
    windy, plain = Bicycle(gust=10.0), Bicycle()
    start = plain.initial(torch.rand(4, 1, dtype=torch.float64))
    state = windy.initial(torch.rand(4, 1, dtype=torch.float64))
    state[:, :10] = start
    action = torch.full((4, 2), 0.01).double()
    # The second number is the chance of a gust, here of none.
    after = windy.step(state, action, f64(0.3, 0.9, 0.9).expand(4, 3))
    assert torch.equal(after[:, :10], plain.step(start, action, f64(0.3).expand(4, 1)))
    assert torch.equal(after[:, 10:], torch.zeros(4, 2).double())
    blown = windy.step(state, action, f64(0.3, 0.0, 0.9).expand(4, 3))
    assert bool((blown[:, 10] > 12).all() and (blown[:, 11] == 99).all())
    assert bool((blown[:, 3] > after[:, 3]).all())
    calmed = windy.restart(blown, torch.tensor([True, False] * 2), torch.rand(4, 1).double())
    assert (calmed[:, 10] != 0).tolist() == [False, True] * 2


def test_displacement_is_read_back_in_wind() -> None:
    sim = Bicycle(gust=50.0, noise=0.0, gust_every=1.0)
    generator = torch.Generator().manual_seed(2)
    states = [sim.initial(f64(0.2))]
    for _ in range(50):
        uniforms = torch.rand(3, generator=generator, dtype=torch.float64)
        states.append(sim.step(states[-1], f64(0.1, 0.013), uniforms))
    trail = torch.stack(states)
    assert bool((trail[:, 10] != 0).any())
    hung = displacement(trail[:, :10], side_force=trail[1:, 10])
    assert torch.allclose(hung, torch.full_like(hung, 0.013), atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1.0, 5.0, 0.01), "force=0.0: expected"),
        ((10.0, -1.0, 5.0, 0.01), "seconds=-1.0: expected"),
        ((10.0, 1.0, math.nan, 0.01), "every=nan: expected"),
        ((10.0, 0.001, 5.0, 0.01), "seconds=0.001: expected at least a step"),
        ((10.0, 6.0, 5.0, 0.01), "seconds=6.0: expected at most every"),
    ],
)
def test_refuses_impossible_winds(arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        Gusts(*arguments)
    assert message in str(refusal.value)
