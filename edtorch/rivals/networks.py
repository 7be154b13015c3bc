"""Policies that are networks, those of all seeds side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from edtorch.types import Parameters

NUMBER = "number"
"""The parameter ``[S]`` (int64) that tells policies apart: rows with the same number have the same
weights."""


@dataclass(frozen=True)
class Networks:
    """a = centre + radius * squash(W_k h(... h(W_1 s + b_1)) + b_k): multilayer perceptrons.

    layers: how many linear ones, k; hidden: h; squash: to [-1, 1]; centre, radius ``[m]``: of the
    scaled actions.  The parameters, each with a row per policy: ``weight_1`` ``[S, h, n]``,
    ``bias_1`` ``[S, h]``, ..., and ``number``.
    """

    layers: int
    hidden: Callable[[Tensor], Tensor]
    squash: Callable[[Tensor], Tensor]
    centre: Tensor
    radius: Tensor

    def action(self, parameters: Parameters, observation: Tensor) -> Tensor:
        """Scaled actions ``[N, m]`` for scaled observations ``[N, n]``; parameters ``[N, ...]``.

        Neighbours with the same number are one matrix product: thirty episodes of a policy read its
        weights once, and not thirty times.
        """
        _, counts = torch.unique_consecutive(parameters[NUMBER], return_counts=True)
        dtype = parameters["weight_1"].dtype
        parts, first = [], 0
        for count in counts.tolist():
            output = observation[first : first + count].to(dtype)
            for layer in range(1, self.layers + 1):
                weight, bias = parameters[f"weight_{layer}"], parameters[f"bias_{layer}"]
                output = linear(output, weight[first], bias[first])
                output = self.hidden(output) if layer < self.layers else self.squash(output)
            parts.append(output)
            first += count
        return self.centre + self.radius * torch.cat(parts).to(self.centre.dtype)


def stacked(networks: Sequence[Sequence[nn.Linear]]) -> Parameters:
    """The parameters of ``Networks``: of each policy its linear layers, in order; copied."""
    parameters = {NUMBER: torch.arange(len(networks))}
    for place, layers in enumerate(zip(*networks, strict=True), 1):
        parameters[f"weight_{place}"] = torch.stack([layer.weight.detach() for layer in layers])
        parameters[f"bias_{place}"] = torch.stack([layer.bias.detach() for layer in layers])
    return parameters
