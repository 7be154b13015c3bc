"""The first parameters of a population, one set per seed."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import torch
from torch import nn

from edtorch.seeding import Purpose, generator_seed
from edtorch.types import Parameters


def population(template: nn.Module, size: int) -> Parameters:
    """The template's parameters, once for each of ``size`` learners: ``[size, ...]``."""
    return {
        name: p.detach().expand(size, *p.shape).clone() for name, p in template.named_parameters()
    }


def drawn(module: nn.Module, seeds: Sequence[int], purpose: Purpose) -> Parameters:
    """Parameters drawn by the module's own initialisers, ``[S, ...]``, by each seed alone.

    For each seed, ``reset_parameters()`` of every submodule that has one is called on a copy, the
    module's own last, with torch's CPU generator seeded from the stream of ``purpose``.  Parameters
    that none of them touches start as the module has them; parameters that do not require a
    gradient are constants of the module and are left out.
    """
    found = []
    for seed in seeds:
        copy = deepcopy(module).cpu()
        with torch.random.fork_rng(devices=[]):
            torch.default_generator.manual_seed(generator_seed(seed, purpose))
            copy.apply(_reset)
        found.append(copy)
    constant = {name for name, p in module.named_parameters() if not p.requires_grad}
    device = {name: p.device for name, p in module.named_parameters()}
    each = [dict(copy.named_parameters()) for copy in found]
    return {
        name: torch.stack([own[name].detach() for own in each]).to(device[name])
        for name in device
        if name not in constant
    }


def _reset(module: nn.Module) -> None:
    reset = getattr(module, "reset_parameters", None)
    if callable(reset):
        reset()
