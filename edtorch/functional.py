"""Modules that know nothing of populations, called with the parameters of a whole population."""

from __future__ import annotations

from torch import Tensor, nn
from torch.func import functional_call, vmap

from edtorch.types import Parameters


def population_call(module: nn.Module, parameters: Parameters, *inputs: Tensor) -> Tensor:
    """``module`` of each learner at its own rows: ``[*more, B, d]``... to ``[*more, B, p]``.

    parameters ``[B, ...]``; those that are not among them are the module's own.  The module sees
    one learner's inputs ``[*more, d]``.
    """

    def one(own: Parameters, *rows: Tensor) -> Tensor:
        return functional_call(module, own, rows)

    found = vmap(one)(parameters, *(x.movedim(-2, 0) for x in inputs))
    return found.movedim(0, -2)
