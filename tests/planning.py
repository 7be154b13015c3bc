"""What the planner is tried on: the swing-up of a cart-pole, and a linear system."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch

from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from edtorch.search.plan import Cost, ramp
from edtorch.search.problem import SearchProblem
from edtorch.search.program import kernels
from edtorch.search.tick_model import TickModel
from tests import cart_poles

HANGING = np.array([0.0, 0.0, math.pi, 0.0])
POLE = 0.5
"""Its length, m."""


def swing_up(dt: float = 0.1) -> TickModel:
    """The cart-pole itself: its equations of motion as an implicit model."""
    structure = cart_poles.structure(cart_poles.told())
    weight = cart_poles.true_weight(structure).numpy()
    return TickModel(structure, weight, dt, np.zeros(1), np.ones(1))


def swing_up_cost(model: TickModel, ticks: int = 40, power: float = 4.0) -> Cost:
    """4 d^2 + .4 (speed^2 + rate^2), d (m) from the tip to where it stands above x = 0."""
    lift = model.structure.lift
    rows = np.zeros((4, lift.size))
    rows[0, [lift.entry("position"), lift.entry("sin angle")]] = 2.0, -2 * POLE
    rows[1, [lift.entry("cos angle"), 0]] = 2 * POLE, -2 * POLE
    rows[2, lift.entry("speed")] = rows[3, lift.entry("rate")] = math.sqrt(0.4)
    return Cost(np.tile(rows, (ticks + 1, 1, 1)), ramp(ticks, power), np.array([0.05]))


def oscillator(push: tuple[float, ...] = (1.0,), dt: float = 0.1) -> TickModel:
    """An unstable mass, x'' = 2 x - .3 x' + push . u, with bounds of u far beyond what is used."""
    m = len(push)
    names = ("1", "x", "v", *(f"u{j}" for j in range(m)))
    lift = Lift(np.zeros(2, bool), np.array([1, 2]), np.ones(2), 3, names)
    terms = Terms(1 + np.arange(2 + m)[:, None], np.full(2 + m, -1))
    structure = Structure(lift, terms, np.array([1]), np.array([1, -1]), np.array([1.0, 0.0]))
    weight = np.array([[2.0, -0.3, *push]])
    return TickModel(structure, weight, dt, np.zeros(m), np.full(m, 1e3))


def oscillator_cost(model: TickModel, ticks: int = 30) -> Cost:
    """x^2 + .1 v^2 + .2 |u|^2."""
    rows = np.zeros((ticks + 1, 2, 3 + len(model.half)))
    rows[:, 0, 1], rows[:, 1, 2] = 1.0, math.sqrt(0.1)
    return Cost(rows, np.ones(ticks + 1), 0.2 * model.half**2, 0.0)


def search_problem(model: TickModel, cost: Cost) -> SearchProblem:
    """The problem whose model this is and whose reward is this cost; only ``learn`` and ``starts``
    are missing."""
    n = len(model.structure.source)

    def unasked(*_: object) -> torch.Tensor:
        raise AssertionError

    learn: Callable[..., object] = unasked
    return SearchProblem(
        names=[f"s{i}" for i in range(n)],
        scale=torch.ones(n, dtype=torch.float64),
        structures={"only": model.structure},
        learn=learn,  # pyright: ignore[reportArgumentType]
        rows=cost.rows,
        action=cost.action,
        middle=torch.from_numpy(model.middle),
        half=torch.from_numpy(model.half),
        period=model.structure.period,
        dt=model.dt,
        starts=unasked,
        judge=None,
        noise=None,
        goal=torch.zeros(cost.ticks + 1, n, dtype=torch.float64),
        told=Told(
            names=tuple(f"s{i}" for i in range(n)),
            unit=(1.0,) * n,
            angle=tuple(model.structure.lift.angle.tolist()),
            rate_of=(-1,) * n,
            actions=tuple(f"u{j}" for j in range(len(model.half))),
        ),
    )


def tip_error(state: np.ndarray) -> np.ndarray:
    """Metres ``[T]`` from the tip to where it is to be, of states ``[T, 4]`` of the cart-pole."""
    across = state[:, 0] - POLE * np.sin(state[:, 2])
    return np.hypot(across, POLE * np.cos(state[:, 2]) - POLE)


def tick_once(
    model: TickModel, weight: np.ndarray, state: np.ndarray, action: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The compiled state one tick later ``[n]``, and its derivative ``[n, n + m]``."""
    n, m = len(state), len(action)
    room = kernels()["room_for"](n, m, model.parts)
    after, by = np.zeros(n), np.zeros((n, n + m))
    x = np.concatenate((state, action))
    kernels()["tick_jacobian"](x, weight, model.parts, room, after, by)
    return after, by
