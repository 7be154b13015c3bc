r"""A reward of what is linear in the lift of the state, such as the place of a rod's tip.

    r(s, a) = -sum_k w_k (sum_e R_ke A_e(s))^2 - rates sum_i (v_i / scale_i)^2
              - action sum_j (a_j / scale_j)^2

A(s) has sine and cosine of every angle (``edtorch.model.lift``), so that distances in space are
squares of linear functions of it, on any turn of an angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from edtorch.model.lift import Lift
from edtorch.model.told import Told
from edtorch.shapes import Actions, Rows, States
from sims.base import Spec

CONSTANT, WEIGHT = "constant", "weight"


class LiftedReward:
    """rows: of each squared term the coefficients by entry of the lift, in physical units (a
    component that is no angle by its name, ``sin NAME`` and ``cos NAME`` of one that is one, and
    ``constant``), and its ``weight``, 1 by default; rates: weight of every rate, by its scale;
    action: of every action, by its scale.

    ValueError for unknown entries and for weights below zero.
    """

    def __init__(
        self,
        spec: Spec,
        rows: Sequence[Mapping[str, float]],
        rates: float = 0.0,
        action: float = 0.0,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        for name, value in (("rates", rates), ("action", action)):
            if not value >= 0:
                raise ValueError(f"{name}={value}: expected a number >= 0")
        if not rows:
            raise ValueError("rows=[]: expected at least one, such as {position: 1, constant: -2}")
        told = Told.of(spec)
        self.lift = lift = Lift.of(told)
        found = [_row(lift, place, row) for place, row in enumerate(rows)]
        found += [
            rates**0.5 * torch.eye(lift.size, dtype=torch.float64)[lift.at[i]]
            for i, of in enumerate(told.rate_of)
            if of >= 0 and rates
        ]
        weights = torch.full((len(spec.action),), float(action), dtype=dtype)
        self.lifted_squares = torch.stack(found).to(dtype), weights
        """R ``[r, A]``, times the roots of the weights, of the lift of scaled states, and weights
        ``[m]`` of squares of scaled actions (``edtorch.rewards.squares``)."""
        self._scale = torch.tensor([q.scale for q in spec.state], dtype=dtype)
        self._action_scale = torch.tensor([q.scale for q in spec.action], dtype=dtype)

    def __call__(self, state: States, action: Actions, /) -> Rows:
        """``[*batch]`` of physical states ``[*batch, n]`` and actions ``[*batch, m]``."""
        scaled = action / self._action_scale
        lifted = self.lift(state / self._scale, scaled)
        rows, weights = self.lifted_squares
        squares = (lifted @ rows.mT.to(lifted)).square().sum(-1)
        return -squares - (weights.to(scaled) * scaled.square()).sum(-1)


def _row(lift: Lift, place: int, row: Mapping[str, float]) -> Tensor:
    coefficients = torch.zeros(lift.size, dtype=torch.float64)
    known = {CONSTANT: 0} | {n: k for k, n in enumerate(lift.names[1 : lift.action_at], start=1)}
    weight = row.get(WEIGHT, 1.0)
    if not weight >= 0:
        raise ValueError(f"rows[{place}].weight={weight}: expected a number >= 0")
    plain = zip(lift.at[~lift.angle], lift.unit[~lift.angle], strict=True)
    unit = {int(at): float(unit) for at, unit in plain}
    for name, value in row.items():
        if name == WEIGHT:
            continue
        if name not in known:
            raise ValueError(
                f"rows[{place}].{name}={value}: expected one of {', '.join((*known, WEIGHT))}"
            )
        coefficients[known[name]] = value * unit.get(known[name], 1.0)
    return weight**0.5 * coefficients
