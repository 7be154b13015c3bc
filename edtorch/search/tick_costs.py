"""The cost of each tick of many trajectories, as torch computes and differentiates it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.lift import Lift
from edtorch.search.plan import Cost


@dataclass(frozen=True, eq=False)
class TickCosts:
    """What ``Cost`` sums over the ticks, where its rows are the same at all of them."""

    lift: Lift
    cost: Cost

    def __call__(self, state: Tensor, raw: Tensor) -> Tensor:
        """``[*more, H + 1, G, B]`` of states ``[*more, H + 1, G, B, n]`` and raw actions ``[*more,
        H + 1, G, B, m]``, the last of which do not count."""
        ticks, cost = torch.arange(self.cost.ticks + 1).view(-1, 1, 1), self.cost
        rows, weight = torch.from_numpy(cost.rows[0]), torch.from_numpy(cost.weight)
        away = matvec(rows, self.lift.of_state(state)).square().sum(-1)
        part = torch.from_numpy(cost.action) * raw.tanh().square() + cost.squash * raw.square()
        arrived, acting = weight.view(-1, 1, 1) * (ticks > 0), ticks < cost.ticks
        return arrived * away + acting * part.sum(-1)
