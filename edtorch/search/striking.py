"""A model of free motion with its stops and a strike over ticks, as compiled kernels take it.

``StrikingModel.parts`` are the arguments ``model`` and ``strike`` of the kernel ``striking_tick``
(``edtorch/search/kernels/strikes.py``), which another kernel calls tick by tick:

    room = room_for(n, m, model)
    strikes = striking_tick(x, weight, model, strike, room, after)

with x [n + m] the scaled state and action, weight [L, K] of the free model, after [n] the next
state, nan where the tick did not complete.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from edtorch.model.impact import Impact
from edtorch.model.strike import Strike
from edtorch.search.striking_program import striking_kernels
from edtorch.search.tick_model import TickModel, product_tree, real, whole


@dataclass(frozen=True, eq=False)
class StrikingModel:
    """Free motion and stops (``free``), the strike, and what it does to the rates."""

    free: TickModel
    strike: Strike
    impact: Impact

    @property
    def parts(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """model and strike, as kernels take them."""
        strike, n = self.strike, len(self.strike.order)
        order = np.concatenate((strike.order, n + strike.action_order))
        tree = (whole(part, np.int64) for part in product_tree(self.impact.terms.factors))
        jump, weight = real(strike.jump), real(self.impact.weight.numpy())
        given = (real(strike.height), whole(order, np.int64), jump, *tree, weight)
        return self.free.parts, given


def struck_states(
    model: StrikingModel, start: np.ndarray, action: np.ndarray, weight: np.ndarray | None = None
) -> np.ndarray:
    """States ``[*P, R, H + 1, n]`` from starts ``[*P, R, n]`` under actions ``[*P, R, H, m]``, nan
    from where a tick did not complete.

    weight: ``[P, L, K]`` of the free model, for starts with P; None: the model's own, without P.
    All scaled.  Raises Unavailable where the kernels cannot be compiled.
    """
    single = weight is None
    weights = real(model.free.weight[None] if weight is None else weight)
    given = [real(part[None] if single else part) for part in (start, action)]
    parts, strike = model.parts
    shape = given[1].shape
    state = np.zeros((*shape[:2], shape[2] + 1, start.shape[-1]))
    striking_kernels()["striking_rollouts"](*given, weights, parts, strike, state)
    return state[0] if single else state
