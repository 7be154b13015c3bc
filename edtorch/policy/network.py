"""A stationary policy by a network of the lift: pi(s) = squash(module(A(s)))."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from edtorch.initial import drawn
from edtorch.law import Arrays, Law
from edtorch.model.lift import Lift
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.squash import Squash
from edtorch.seeding import Purpose
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
        self.lift, self.entries = lift, torch.tensor(lift.entries_of(components))
        sizes, layers = [len(self.entries), *hidden, len(squash.half)], list[nn.Module]()
        for inputs, outputs in pairwise(sizes):
            layers += [nn.Linear(inputs, outputs), nn.Tanh()]
        self._template = nn.Sequential(*layers[:-1]).double()
        self._names = [(f"{k}.weight", f"{k}.bias") for k in range(0, len(layers), 2)]

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """Drawn for each seed by torch's initialisers."""
        return drawn(self._template, seeds, Purpose.POLICY)

    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """Drawn by torch's initialisers, scaled to the deviation 5/3 ``spread`` / root of the
        inputs: with 5/3, tanh keeps the variance from layer to layer, where torch's is 1/root 3."""
        gain = 3**0.5 * 5 / 3 * spread
        seeds = generator.integers(2**32, size=count).tolist()
        return {name: gain * p for name, p in self.initial(seeds).items()}

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """The network's output.

        The layers are products over the population; ``edtorch.functional.population_call`` of a
        module takes several times as long for one state.
        """
        entries = self.lift.of_state(state).index_select(-1, self.entries)
        own = entries.movedim(-2, 0)
        rows = own.flatten(1, -2) if own.ndim > 2 else own.unsqueeze(1)
        for place, (weight, bias) in enumerate(self._names):
            if place:
                rows = rows.tanh()
            rows = torch.baddbmm(parameters[bias].unsqueeze(1), rows, parameters[weight].mT)
        return rows.reshape(*own.shape[:-1], rows.shape[-1]).movedim(0, -2)

    def raw_law(self, parameters: Arrays) -> Law:
        """See ``BoundedPolicy``."""
        lifted = self.lift.law(self.entries.numpy())
        first, *layers = [(parameters[weight], parameters[bias]) for weight, bias in self._names]

        def raw(state: NDArray[Any]) -> NDArray[Any]:
            row = first[0] @ lifted(state) + first[1]
            for weight, bias in layers:
                row = weight @ np.tanh(row) + bias
            return row

        return raw
