r"""A stationary policy of radial basis functions of the lift: pi(s) = squash(W phi(x)).

    phi_k(x) = exp(-1/2 sum_e ((x_e - c_ke) / w_e)^2),   x = A(s),

normalised: divided by their sum, so that the nearest centre counts where none is near.  Centres,
widths and weights are all learned, as those of PILCO's swing-ups (Deisenroth & Rasmussen, 2011,
eq. 32, whose widths are shared by the centres, too).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.model.lift import Lift
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


@final
class RadialPolicy(BoundedPolicy):
    """``centres`` k functions of the d entries of the ``lift`` of these ``components``.

    parameters: ``weight`` ``[B, m, k]``, ``centre`` ``[B, k, d]``, ``log_width`` ``[B, d]``.
    width: at first, in units of the scaled lift.  ValueError for settings that are impossible.
    """

    def __init__(
        self,
        lift: Lift,
        components: Sequence[int],
        squash: Squash,
        centres: int,
        width: float = 0.5,
        normalised: bool = True,
    ) -> None:
        if centres < 1:
            raise ValueError(f"centres={centres}: expected an integer >= 1")
        if not width > 0:
            raise ValueError(f"width={width}: expected a number > 0")
        super().__init__(squash)
        self.lift, self.entries = lift, torch.tensor(lift.entries_of(components))
        self.centres, self.width = centres, width
        self.normalised = normalised

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The middle of the range of each action, everywhere."""
        return self._parameters(len(seeds), 0.0, np.random.default_rng(0))

    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """Weights of deviation ``spread``; centres at angles anywhere on the circle, other
        components normal with the deviation of their scale."""
        return self._parameters(count, spread, generator)

    def features(self, parameters: Parameters, state: Tensor) -> Tensor:
        """phi: ``[*more, B, n] -> [*more, B, k]``."""
        x = self.lift.of_state(state).index_select(-1, self.entries).unsqueeze(-2)
        away = (x - parameters["centre"]) * (-parameters["log_width"]).exp().unsqueeze(-2)
        exponent = -0.5 * away.square().sum(-1)
        return torch.softmax(exponent, dim=-1) if self.normalised else torch.exp(exponent)

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """W phi."""
        return matvec(parameters["weight"], self.features(parameters, state))

    def raw_law(self, parameters: Arrays) -> Law:
        """See ``BoundedPolicy``."""
        weight, centre = parameters["weight"], parameters["centre"]
        scale, lifted = np.exp(-parameters["log_width"]), self.lift.law(self.entries.numpy())

        def raw(state: NDArray[Any]) -> NDArray[Any]:
            exponent = -0.5 * np.square((lifted(state) - centre) * scale).sum(-1)
            if not self.normalised:
                return weight @ np.exp(exponent)
            phi = np.exp(exponent - exponent.max())
            return weight @ phi / phi.sum()

        return raw

    def _parameters(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        lift, m = self.lift, len(self.squash.half)
        where = (count, self.centres, lift.states)
        turn = generator.uniform(-np.pi, np.pi, where) / lift.unit
        place = np.where(lift.angle, turn, generator.standard_normal(where))
        weight = spread * generator.standard_normal((count, m, self.centres))
        width = np.full((count, len(self.entries)), np.log(self.width))
        return {
            "weight": torch.from_numpy(weight),
            "centre": lift.of_state(torch.from_numpy(place))[..., self.entries],
            "log_width": torch.from_numpy(width),
        }
