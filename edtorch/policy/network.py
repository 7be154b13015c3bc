"""A stationary policy by a network of the lift: pi(s) = squash(module(A(s)))."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import final

import numpy as np
from torch import Tensor, nn

from edtorch.model.lift import Lift
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.module import ModulePolicy
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


@final
class NetworkPolicy(BoundedPolicy):
    """hidden: units of each layer of hyperbolic tangents on the entries of the ``lift`` of these
    ``components``; parameters: as torch names those of the layers, ``[B, ...]`` each.  ValueError
    for layers without a unit."""

    def __init__(
        self, lift: Lift, components: Sequence[int], squash: Squash, hidden: Sequence[int]
    ) -> None:
        if min(hidden, default=1) < 1:
            raise ValueError(f"hidden={list(hidden)}: expected integers >= 1")
        super().__init__(squash)
        self.lift, self.entries = lift, lift.entries_of(components)
        sizes, layers = [len(self.entries), *hidden], list[nn.Module]()
        for inputs, outputs in pairwise(sizes):
            layers += [nn.Linear(inputs, outputs), nn.Tanh()]
        m = len(squash.half)
        network = nn.Sequential(*layers, nn.Linear(sizes[-1], m))
        self.network = ModulePolicy(network, sizes[0], m)

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """Drawn for each seed by torch's initialisers."""
        return self.network.initial(seeds)

    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """Drawn by torch's initialisers, scaled to the deviation 5/3 ``spread`` / root of the
        inputs: with 5/3, tanh keeps the variance from layer to layer, where torch's is 1/root 3."""
        gain = 3**0.5 * 5 / 3 * spread
        seeds = generator.integers(2**32, size=count).tolist()
        return {name: gain * p for name, p in self.network.initial(seeds).items()}

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """The network's output."""
        return self.network.action(parameters, self.lift.of_state(state)[..., self.entries])
