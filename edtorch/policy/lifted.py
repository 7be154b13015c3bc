"""A stationary policy linear in products of the lift: pi(s) = squash(theta . phi(A(s)))."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import torch
from torch import Tensor

from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


@final
class LiftedPolicy(BoundedPolicy):
    """phi: the F ``terms``, without actions and derivatives, of the ``lift`` of a scaled state.

    parameters: ``weight`` theta ``[B, m, F]``.  It is smooth, bounded, and the same on every
    turn of an angle.  ValueError for terms with actions or derivatives.
    """

    def __init__(self, lift: Lift, terms: Terms, squash: Squash) -> None:
        if (terms.factors >= lift.action_at).any() or (terms.derivative >= 0).any():
            raise ValueError("terms: expected none with actions or derivatives")
        super().__init__(squash)
        self.lift, self.terms = lift, terms

    @property
    def linear_terms(self) -> Terms:
        """phi."""
        return self.terms

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The middle of the range of each action, everywhere."""
        return {"weight": self.squash.half.new_zeros(len(seeds), *self._shape)}

    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """Normal weights of deviation ``spread``."""
        drawn = spread * generator.standard_normal((count, *self._shape))
        return {"weight": torch.from_numpy(drawn)}

    def features(self, state: Tensor) -> Tensor:
        """phi: ``[*batch, n] -> [*batch, F]``."""
        return self.terms(self.lift.of_state(state))

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """theta . phi."""
        return matvec(parameters["weight"], self.features(state))

    def raw_law(self, parameters: Arrays) -> Law:
        """See ``BoundedPolicy``."""
        weight, lifted, terms = parameters["weight"], self.lift.law(), self.terms.law()
        return lambda state: weight @ terms(lifted(state))

    @property
    def _shape(self) -> tuple[int, int]:
        return len(self.squash.half), self.terms.count
