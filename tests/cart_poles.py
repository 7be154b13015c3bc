"""The swing-up of a cart and a pole: what is told, its true weights, trials of random actions."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from edtorch.types import Transition
from sims.base import Quantity, Spec
from sims.rows import TORCH
from sims.tasks.cart_pole import GRAVITY, derivative_over
from sims.tasks.integrate import runge_kutta_over

DT = 0.1
_MOVE = runge_kutta_over(TORCH, derivative_over(TORCH), 4, 10)


def spec(speed: float = 3.0, rate: float = 6.0, position: float = 1.0) -> Spec:
    """Of the cart-pole of ``sims.tasks.cart_pole``, with these scales."""
    return Spec(
        name="swing_up",
        state=(
            Quantity("position", "m", scale=position),
            Quantity("speed", "m/s", scale=speed, rate_of="position"),
            Quantity("angle", "rad", period=2 * math.pi),
            Quantity("rate", "rad/s", scale=rate, rate_of="angle"),
        ),
        action=(Quantity("force", "N", scale=10.0, low=-10.0, high=10.0),),
        dt=DT,
        time_limit=4.0,
        disturbance_dim=0,
        reset_dim=4,
        clip_action=True,
        headline="angle",
    )


def told(**scales: float) -> Told:
    return Told.of(spec(**scales), invariant=["position"])


def structure(told: Told, kind: str = "implicit") -> Structure:
    lift = Lift.of(told)
    return Structure.of(told, lift, getattr(Terms, kind)(told, lift))


def true_derivative(told: Told, state: Tensor, action: Tensor) -> Tensor:
    """ds/dt ``[*batch, 4]`` of the simulator, scaled."""
    unit = torch.tensor(told.unit, dtype=state.dtype)
    columns = derivative_over(TORCH)((state * unit).unbind(-1), 10 * action[..., 0])
    return torch.stack(columns, dim=-1) / unit


def true_weight(structure: Structure) -> Tensor:
    """Its equations of motion as an implicit model, ``[2, K]``, x the position and q the angle:

    (M + m) x'' = F - b x' + m l/2 (q'' cos q - q'^2 sin q),  2 l/3 q'' = g sin q + x'' cos q.
    """
    lift, terms = structure.lift, structure.terms
    _, speed, _, rate = lift.unit
    weight = torch.zeros(2, terms.count, dtype=torch.float64)

    def put(row: int, names: list[str], derivative: int, value: float) -> None:
        wanted = sorted(lift.entry(name) for name in names)
        rows = [sorted(set(factors) - {0}) for factors in terms.factors.tolist()]
        powers = [sum(k > 0 for k in factors) for factors in terms.factors.tolist()]
        (k,) = (
            k for k in range(terms.count)
            if rows[k] == sorted(set(wanted)) and powers[k] == len(wanted)
            and terms.derivative[k] == derivative
        )  # fmt: skip
        weight[row, k] = value

    mass, swing = 0.5 + 0.5, 0.5 * 0.5 / 2
    put(0, ["force"], -1, 10 / mass / speed)
    put(0, ["speed"], -1, -0.1 / mass)
    put(0, ["sin angle", "rate", "rate"], -1, -swing / mass * rate**2 / speed)
    put(0, ["cos angle"], 1, swing / mass * rate / speed)
    put(1, ["sin angle"], -1, 3 / (2 * 0.5) * GRAVITY / rate)
    put(1, ["cos angle"], 0, 3 / (2 * 0.5) * speed / rate)
    return weight


def moved(state: Tensor, force: Tensor) -> Tensor:
    """The simulator's state ``[*batch, 4]`` a tick later; m, m/s, rad, rad/s and N."""
    return torch.stack(_MOVE(state.unbind(-1), force[..., 0], DT), dim=-1)


def trial(told: Told, seed: int, ticks: int = 40, noise: float = 0.01) -> Transition:
    """A trial from near hanging with a uniform random action in each tick, read with noise."""
    generator = torch.Generator().manual_seed(seed)
    normals = torch.randn(ticks + 2, 4, generator=generator, dtype=torch.float64)
    action = 2 * torch.rand(ticks, 1, generator=generator, dtype=torch.float64) - 1
    state = torch.tensor([0.0, 0.0, math.pi, 0.0], dtype=torch.float64) + 0.1 * normals[0]
    states = [state]
    for force in 10 * action:
        state = moved(state, force)
        states.append(state)
    read = torch.stack(states) + noise * normals[1:]
    read = read / torch.tensor(told.unit, dtype=torch.float64)
    return Transition(
        read[:-1], action, read[1:], torch.tensor(DT, dtype=torch.float64),
        torch.ones(ticks, dtype=torch.bool),
    )  # fmt: skip
