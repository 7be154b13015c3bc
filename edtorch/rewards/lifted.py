r"""A reward of what is linear in the lift of the state, such as the place of a rod's tip.

    r_t(s, a) = -sum_k w_k (sum_e R_ke A_e(s) - c_k(t))^2 - rates sum_i (v_i / scale_i)^2
                - action sum_j (a_j / scale_j)^2

A(s) has sine and cosine of every angle (``edtorch.model.lift``), so that distances in space are
squares of linear functions of it, on any turn of an angle.  c_k is a reference to follow, 0 where
none is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from edtorch.model.lift import Lift
from edtorch.model.told import Told
from edtorch.rewards.reference import reference_values
from edtorch.shapes import Actions, Rows, States
from sims.base import Spec

CONSTANT, WEIGHT, REFERENCE = "constant", "weight", "reference"


class LiftedReward:
    """rows: of each squared term the coefficients by entry of the lift, in physical units (a
    component that is no angle by its name, ``sin NAME`` and ``cos NAME`` of one that is one, and
    ``constant``), its ``weight``, 1 by default, and perhaps the ``reference`` that it is to follow
    (``edtorch.rewards.reference``); rates: weight of every rate, by its scale; action: of every
    action, by its scale; angles: names of angles beside those of the domain (``told.angles``).

    ValueError for unknown entries and references, and for weights below zero.
    """

    def __init__(
        self,
        spec: Spec,
        rows: Sequence[Mapping[str, Any]],
        rates: float = 0.0,
        action: float = 0.0,
        angles: Sequence[str] = (),
        dtype: torch.dtype = torch.float64,
    ) -> None:
        for name, value in (("rates", rates), ("action", action)):
            if not value >= 0:
                raise ValueError(f"{name}={value}: expected a number >= 0")
        if not rows:
            raise ValueError("rows=[]: expected at least one, such as {position: 1, constant: -2}")
        told = Told.of(spec, angles=angles)
        self.lift = lift = Lift.of(told)
        found = [_row(lift, place, row) for place, row in enumerate(rows)]
        found += [
            rates**0.5 * torch.eye(lift.size, dtype=torch.float64)[lift.at[i]]
            for i, of in enumerate(told.rate_of)
            if of >= 0 and rates
        ]
        self._rows = torch.stack(found).to(dtype)
        self._weights = torch.full((len(spec.action),), float(action), dtype=dtype)
        self._followed = {
            place: (row.get(WEIGHT, 1.0) ** 0.5, row[REFERENCE])
            for place, row in enumerate(rows)
            if row.get(REFERENCE) is not None
        }
        self._dt = spec.dt
        for place, (_, told_of) in self._followed.items():
            try:
                reference_values(told_of, 0, self._dt)
            except (TypeError, ValueError) as error:
                raise ValueError(f"rows[{place}].{error}") from error
        self.timed = bool(self._followed)
        """Whether something is to be followed (``edtorch.rewards.base.Reward``)."""
        self._scale = torch.tensor([q.scale for q in spec.state], dtype=dtype)
        self._action_scale = torch.tensor([q.scale for q in spec.action], dtype=dtype)

    def lifted_squares(self, ticks: int) -> tuple[Tensor, Tensor]:
        """R ``[ticks + 1, r, A]``, times the roots of the weights, of the lift of scaled states at
        the ticks of an episode, and weights ``[m]`` of squares of scaled actions
        (``edtorch.rewards.squares``)."""
        rows = self._rows.repeat(ticks + 1, 1, 1)
        for place, (root, told) in self._followed.items():
            rows[:, place, 0] -= root * reference_values(told, ticks, self._dt).to(rows)
        return rows, self._weights

    def __call__(self, state: States, action: Actions, /) -> Rows:
        """``[*batch]`` of physical states ``[*batch, n]`` and actions ``[*batch, m]``.

        Without the rows that have a reference: what they want depends on the time of an episode,
        which is not given here.
        """
        scaled = action / self._action_scale
        lifted = self.lift(state / self._scale, scaled)
        always = [k for k in range(len(self._rows)) if k not in self._followed]
        squares = (lifted @ self._rows[always].mT.to(lifted)).square().sum(-1)
        return -squares - (self._weights.to(scaled) * scaled.square()).sum(-1)


def _row(lift: Lift, place: int, row: Mapping[str, Any]) -> Tensor:
    weight = row.get(WEIGHT, 1.0)
    if not weight >= 0:
        raise ValueError(f"rows[{place}].weight={weight}: expected a number >= 0")
    told = {name: value for name, value in row.items() if name not in (WEIGHT, REFERENCE)}
    return weight**0.5 * lifted_row(lift, told, f"rows[{place}]", WEIGHT, REFERENCE)


def lifted_row(lift: Lift, told: Mapping[str, Any], where: str, *others: str) -> Tensor:
    """Coefficients ``[A]`` of scaled entries of the lift from those by name, in physical units, as
    ``LiftedReward`` has them.  ValueError for unknown entries, which begins with ``where``; others:
    names to list in it, too."""
    coefficients = torch.zeros(lift.size, dtype=torch.float64)
    known = {CONSTANT: 0} | {n: k for k, n in enumerate(lift.names[1 : lift.action_at], start=1)}
    plain = zip(lift.at[~lift.angle], lift.unit[~lift.angle], strict=True)
    unit = {int(at): float(unit) for at, unit in plain}
    for name, value in told.items():
        if name not in known:
            names = ", ".join((*known, *others))
            raise ValueError(f"{where}.{name}={value}: expected one of {names}")
        if not isinstance(value, int | float):
            raise ValueError(f"{where}.{name}={value}: expected a number")
        coefficients[known[name]] = value * unit.get(known[name], 1.0)
    return coefficients
