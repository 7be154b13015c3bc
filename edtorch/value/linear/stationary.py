r"""The stationary regulator about a named equilibrium of a mechanism's model.

Where an arrangement is to be held, some components of the state are named (a pole upright, a wheel
at its cruising speed), and the others and the action are such that nothing moves that is to stand
still: Newton's method on ds/dt = 0, each step that of ``edtorch.value.linear.equilibrium`` on the
linearised model.  There the tick, by the derivatives of its Runge-Kutta steps, is the linear system
whose regulator it is (``stationary_lqr``).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.mechanism import (
    Structure,
    derivative_jacobian,
    runge_kutta_jacobian,
    state_derivative,
)
from edtorch.value.linear.equilibrium import equilibrium
from edtorch.value.linear.lqr import stationary_lqr

_STEPS = 30
"""Of Newton's method, at most."""
_SLACK = 1e-4
"""Weight of usual values beside that of standing still."""


class NoEquilibrium(ValueError):
    """The model does not stand still near the state that was named."""


@dataclass(frozen=True)
class StationaryRegulator:
    """u = action + gain (s - state), scaled units: state ``[n]``, action ``[m]``, gain ``[m, n]``;
    cost ``[n, n]``, P of the cost to go (s - state)'P(s - state)."""

    state: Tensor
    action: Tensor
    gain: Tensor
    cost: Tensor


def regulator_at(
    structure: Structure,
    weight: Tensor,
    state: Float[Tensor, " n"],
    held: Float[Tensor, " n"] | Tensor,
    middle: Float[Tensor, " m"],
    half: Float[Tensor, " m"],
    seconds: float,
    rows: Float[Tensor, "r A"],
    price: Float[Tensor, " m"],
    tolerance: float = 1e-6,
) -> StationaryRegulator:
    """The regulator of ticks of ``seconds`` whose cost is |rows A(s, u)|^2 + sum price
    ((u - u_eq) / half)^2, to second order about the equilibrium.

    weight ``[L, K]``; state: wanted values where ``held`` (bool ``[n]``) says so, and where to
    start from elsewhere; middle and half: of the range of the actions, in which u_eq is; rows: on
    the entries of the lift; tolerance: scaled change per second that counts as standing still.
    Raises NoEquilibrium where the model moves in every such state, NotConverged where its actions
    cannot stabilise it there.
    """
    state, action = standing(structure, weight, state, held, middle, half, tolerance)
    return regulator_about(structure, weight, state, action, seconds, rows, price / half.square())


def regulator_about(
    structure: Structure,
    weight: Tensor,
    state: Float[Tensor, " n"],
    action: Float[Tensor, " m"],
    seconds: float,
    rows: Float[Tensor, "r A"],
    cost: Float[Tensor, " m"],
) -> StationaryRegulator:
    """As ``regulator_at``, of deviations from a state and an action, whether or not the model
    stands still there; cost: of the square of each action."""
    n = state.shape[-1]
    jacobian = runge_kutta_jacobian(structure, weight, state, action, seconds)
    slope = rows @ structure.lift.jacobian(state, action)[:, :n]
    gain, found = stationary_lqr(
        jacobian[:, :n], jacobian[:, n:], slope.mT @ slope, torch.diag(cost)
    )
    return StationaryRegulator(state, action, gain, found)


def standing(
    structure: Structure,
    weight: Tensor,
    state: Tensor,
    held: Tensor,
    middle: Tensor,
    half: Tensor,
    tolerance: float = 1e-6,
) -> tuple[Tensor, Tensor]:
    """Equilibrium state ``[n]`` and action ``[m]``; arguments and errors as for ``regulator_at``.

    What stands still: the components that are held, those that the model depends on and those with
    a learned derivative; a position of which nothing depends may drift.
    """
    lift = structure.lift
    acts = torch.zeros(lift.size, dtype=torch.bool)
    acts[torch.from_numpy(structure.terms.factors).flatten()] = True
    still = held | acts[torch.from_numpy(lift.at)]
    still[torch.from_numpy(structure.learned)] = True
    centre, action, moves = state, middle, state
    for _ in range(_STEPS):
        moves = state_derivative(structure, weight, state, action) * still
        if float(moves.abs().max()) < tolerance:
            return state, action
        jacobian = derivative_jacobian(structure, weight, state, action) * still.unsqueeze(-1)
        D, G = jacobian.split([len(state), len(action)], dim=-1)
        found = equilibrium(
            *(part.unsqueeze(0) for part in (D, G, moves - matvec(D, state) - matvec(G, action))),
            centre.unsqueeze(0),
            torch.ones_like(state).unsqueeze(0),
            held,
            middle,
            half,
            _SLACK,
        )
        state, action = (part.squeeze(0) for part in found)
    fastest = int(moves.abs().argmax())
    name = lift.names[lift.at[fastest]].removeprefix("sin ")
    raise NoEquilibrium(
        f"no equilibrium: {name!r} moves by {float(moves[fastest]):.3g} a second (scaled units) in"
        " the state that comes nearest; expected targets that the actions can hold"
    )
