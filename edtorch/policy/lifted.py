"""A stationary policy linear in products of the lift: pi(s) = squash(theta . phi(A(s)))."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


class LiftedPolicy:
    """phi: the F ``terms``, without actions and derivatives, of the ``lift`` of a scaled state.

    parameters: ``weight`` theta ``[B, m, F]``.  It is smooth, bounded, and the same on every
    turn of an angle.  ValueError for terms with actions or derivatives.
    """

    label = "LiftedPolicy"

    def __init__(self, lift: Lift, terms: Terms, squash: Squash) -> None:
        if (terms.factors >= lift.action_at).any() or (terms.derivative >= 0).any():
            raise ValueError("terms: expected none with actions or derivatives")
        self.lift, self.terms, self.squash = lift, terms, squash

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The middle of the range of each action, everywhere."""
        m = len(self.squash.half)
        return {"weight": self.squash.half.new_zeros(len(seeds), m, self.terms.count)}

    def features(self, state: Tensor) -> Tensor:
        """phi: ``[*batch, n] -> [*batch, F]``."""
        return self.terms(self.lift(state, state.new_zeros(*state.shape[:-1], self.lift.actions)))

    def action(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """``[*more, B, n] -> [*more, B, m]``."""
        return self.squash(matvec(parameters["weight"], self.features(state)))
