"""The five links against a floating biped of seven coordinates, derived by automatic
differentiation, whose contacts are constraints with multipliers."""

from __future__ import annotations

from itertools import product

import pytest
import torch
from torch import Tensor
from torch.func import grad, hessian, jacrev, jvp, vmap

from sims.rows import TORCH
from sims.tasks import five_links as of

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.*:DeprecationWarning")  # of torch itself

KNEES = torch.tensor([[1.0, -1, 0, 0, 0, 0, 0], [0, 0, 0, -1, 1, 0, 0]]).double()
"""Of (five leans, place of the hip): how fast the knees open."""
TORQUES = torch.tensor(
    [[1.0, 0, 0, 0], [-1, 1, 0, 0], [0, -1, -1, 0], [0, 0, 1, -1], [0, 0, 0, 1], [0] * 4, [0] * 4]
).double()
"""Of knee and hip of the stance leg, hip and knee of the swing leg."""


def _along(lean: Tensor) -> Tensor:
    return torch.stack([lean.sin(), lean.cos()])


def _centres(q: Tensor) -> Tensor:
    """Of the links, ``[5, 2]``, from the hip downward and upward."""
    hip = q[5:]
    knees = [hip - 0.4 * _along(q[k]) for k in (1, 3)]
    return torch.stack(
        [
            knees[0] - 0.128 * _along(q[0]),
            hip - 0.163 * _along(q[1]),
            hip + 0.2 * _along(q[2]),
            hip - 0.163 * _along(q[3]),
            knees[1] - 0.128 * _along(q[4]),
        ]
    )


def _feet(q: Tensor) -> Tensor:
    """Stance and swing foot, ``[2, 2]``."""
    return torch.stack([q[5:] - 0.4 * (_along(q[i]) + _along(q[j])) for i, j in ((0, 1), (4, 3))])


def _energies(q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    masses, inertias = q.new_tensor([3.2, 6.8, 20, 6.8, 3.2]), q.new_tensor(of.INERTIAS)
    centres, speeds = jvp(_centres, (q,), (v,))[:2]
    kinetic = 0.5 * ((masses * (speeds**2).sum(-1)).sum() + (inertias * v[:5] ** 2).sum())
    return kinetic, 9.81 * (masses * centres[:, 1]).sum()


def _lagrangian(q: Tensor, v: Tensor) -> Tensor:
    kinetic, potential = _energies(q, v)
    return kinetic - potential


def pinned(leans: Tensor, rates: Tensor) -> tuple[Tensor, Tensor]:
    """Seven coordinates and rates with the stance foot at rest at the origin."""

    def whole(leans: Tensor) -> Tensor:
        return torch.cat([leans, 0.4 * (_along(leans[0]) + _along(leans[1]))])

    return jvp(whole, (leans,), (rates,))[:2]


def energy(leans: Tensor, rates: Tensor) -> Tensor:
    """Kinetic and potential energy, J ``[*batch]``."""

    def one(leans: Tensor, rates: Tensor) -> Tensor:
        return sum(_energies(*pinned(leans, rates)), torch.zeros(()).to(leans))

    return vmap(one)(leans, rates)


def _constrained(mass: Tensor, push: Tensor, rows: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
    """x and multipliers of M x = push + rows' multipliers, rows x = ends."""
    corner = torch.zeros(len(rows), len(rows)).to(mass)
    whole = torch.cat([torch.cat([mass, -rows.mT], 1), torch.cat([rows, corner], 1)])
    found = torch.linalg.solve(whole, torch.cat([push, ends]))
    return found[:7], found[7:]


def _stopped(
    mass: Tensor, push: Tensor, rows: Tensor, ends: Tensor, stops: list[bool]
) -> tuple[Tensor, Tensor, int]:
    """The same with knees that may only open where ``stops``: the one choice of closed knees whose
    forces push and whose others open; also how many are closed."""
    found = []
    for closed in product((False, True), repeat=2):
        if any(c and not s for c, s in zip(closed, stops, strict=True)):
            continue
        held = KNEES[list(closed)]
        nothing = torch.zeros(len(held)).double()
        x, force = _constrained(mass, push, torch.cat([rows, held]), torch.cat([ends, nothing]))
        opens = KNEES @ x
        pulls = bool((force[len(rows) :] < 0).any())
        closes = any(
            s and not c and float(o) < 0 for s, c, o in zip(stops, closed, opens, strict=True)
        )
        if not pulls and not closes:
            found.append((x, force, sum(closed)))
    assert len(found) == 1
    return found[0]


def draws(count: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Leans, rates ``[count, 5]``, torques ``[count, 4]``."""
    generator = torch.Generator().manual_seed(seed)

    def normal(n: int) -> Tensor:
        return torch.randn(count, n, generator=generator, dtype=torch.float64)

    return 0.5 * normal(5), 3 * normal(5), 60 * normal(4)


STOPS = [(a, b) for a in (False, True) for b in (False, True)]


@pytest.mark.oracle
@pytest.mark.parametrize("stops", STOPS)
def test_accelerations_and_ground_force(stops: tuple[bool, bool]) -> None:
    leans, rates, torques = draws(8)
    # A knee at its stop: closed and at rest, to within what counts as that.
    for at, shank, thigh in ((stops[0], 0, 1), (stops[1], 4, 3)):
        if at:
            leans[:, shank], rates[:, shank] = leans[:, thigh], rates[:, thigh]
    q, v = leans.unbind(-1), rates.unbind(-1)
    knees = of.knees_over(TORCH)(q, v)
    assert [bool((k == 1).all()) for k in knees] == list(stops)
    a = of.accelerations_over(TORCH)(q, v, torques.unbind(-1), knees)
    ground = torch.stack(of.ground_over(TORCH)(q, v, a), -1)
    closed = set()
    for k in range(8):
        whole, rate = pinned(leans[k], rates[k])
        mass = hessian(_lagrangian, 1)(whole, rate)
        mixed = jacrev(grad(_lagrangian, 1), 0)(whole, rate)
        push = TORQUES @ torques[k] + grad(_lagrangian, 0)(whole, rate) - mixed @ rate

        def foot(q: Tensor) -> Tensor:
            return _feet(q)[0]

        rows = jacrev(foot)(whole)
        bent = jvp(lambda q, v=rate: jvp(foot, (q,), (v,))[1], (whole,), (rate,))[1]
        x, force, count = _stopped(mass, push, rows, -bent, list(stops))
        closed.add(count)
        found = torch.stack([row[k] for row in a])
        torch.testing.assert_close(found, x[:5], rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(ground[k], force[:2], rtol=1e-9, atol=1e-8)
    assert max(closed) == sum(stops) and (sum(stops) == 0 or min(closed) < sum(stops))


@pytest.mark.oracle
@pytest.mark.parametrize("stops", STOPS)
def test_strikes(stops: tuple[bool, bool]) -> None:
    leans, rates, _ = draws(8, seed=1)
    for at, shank, thigh in ((stops[0], 0, 1), (stops[1], 4, 3)):
        if at:
            leans[:, shank], rates[:, shank] = leans[:, thigh], rates[:, thigh]
    q, v = leans.unbind(-1), rates.unbind(-1)
    _, _, east, up = of.foot_over(TORCH)(q, v)
    knees = of.knees_over(TORCH)(q, v)
    after = of.impact_over(TORCH)(q[::-1], v[::-1], east, up, knees[::-1])
    for k in range(8):
        whole, rate = pinned(leans[k], rates[k])
        mass = hessian(_lagrangian, 1)(whole, rate)
        rows = jacrev(lambda q: _feet(q)[1])(whole)
        torch.testing.assert_close(rows @ rate, torch.stack([east[k], up[k]]), rtol=0, atol=1e-13)
        x, *_ = _stopped(mass, mass @ rate, rows, torch.zeros(2).double(), list(stops))
        found = torch.stack([row[k] for row in after])
        torch.testing.assert_close(found, x[:5].flip(0), rtol=1e-10, atol=1e-11)
        gained = _energies(whole, x)[0] - _energies(whole, rate)[0]
        assert float(gained) < 0


@pytest.mark.oracle
def test_a_knee_hit_changes_momentum_by_its_own_column() -> None:
    leans, rates, _ = draws(20, seed=2)
    leans[:, 0] = leans[:, 1]
    rates[:, 0] = rates[:, 1] - 1.0
    q, v, nothing = leans.unbind(-1), rates.unbind(-1), torch.zeros(20).double()
    after = of.impact_over(TORCH)(q, v, nothing, nothing, (1.0 + nothing, nothing))
    change = torch.stack(after, -1) - rates
    kinetic = hessian(lambda q, v: _energies(*pinned(q, v))[0], 1)
    impulse = (vmap(kinetic)(leans, rates) @ change[..., None])[..., 0]
    column = torch.tensor([1.0, -1, 0, 0, 0]).double()
    assert float(impulse[:, 0].min()) > 0
    torch.testing.assert_close(impulse, impulse[:, :1] * column, rtol=0, atol=1e-12)
    torch.testing.assert_close(after[0], after[1], rtol=0, atol=1e-13)
    assert float((energy(leans, torch.stack(after, -1)) - energy(leans, rates)).max()) < 0
