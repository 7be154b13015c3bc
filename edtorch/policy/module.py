"""Any ``nn.Module`` from states to actions as a policy: a network, radial basis functions."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import torch
from torch import Tensor, nn

from edtorch.functional import population_call
from edtorch.initial import drawn
from edtorch.policy.policies import Policy, limited
from edtorch.seeding import Purpose
from edtorch.shapes import States
from edtorch.types import Parameters

_RESERVED = ("limit", "model")
"""Names that stand for something else beside a policy's parameters."""


class ModulePolicy(nn.Module):
    """pi(s) = module(s), the module taking one learner's states ``[*more, n]`` to ``[*more, m]``.

    Both are scaled (``Quantity.scale`` divides them), so that an action of 1 is one scale.  The
    module is copied, in ``dtype``.  Its parameters that require a gradient are learned; each seed
    draws its own by the module's initialisers (``edtorch.initial.drawn``).  ValueError for a module
    without such, or whose action has another shape.
    """

    def __init__(
        self, module: nn.Module, states: int, actions: int, dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        self.module = deepcopy(module).to(dtype)
        self.names = [n for n, p in self.module.named_parameters() if p.requires_grad]
        if not self.names:
            raise ValueError(f"{self.label} has no parameter that requires a gradient")
        for name in _RESERVED:
            if name in self.names:
                raise ValueError(f"{self.label} has a parameter called {name!r}: rename it")
        for lead in ((), (3,)):
            state = torch.full((*lead, states), 0.1, dtype=dtype)
            action = self._tried(state)
            found = tuple(action.shape) if isinstance(action, Tensor) else type(action).__name__
            if found != (*lead, actions):
                raise ValueError(
                    f"{self.label} takes states of shape {tuple(state.shape)} to {found},"
                    f" expected actions of shape {(*lead, actions)}"
                )
            if not bool(action.isfinite().all()):
                raise ValueError(f"{self.label} gives actions that are not finite")

    def _tried(self, state: Tensor) -> Tensor:
        """Whatever the module gives."""
        try:
            with torch.no_grad():
                return self.module(state)
        except Exception as error:
            raise ValueError(
                f"{self.label} fails for states of shape {tuple(state.shape)}:"
                f" {type(error).__name__}: {error}"
            ) from error

    @property
    def label(self) -> str:
        """The module's class."""
        return type(self.module).__name__

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """Drawn for each seed."""
        return drawn(self.module, seeds, Purpose.POLICY)

    def forward(self, state: States) -> Tensor:
        """The module's action with its own parameters."""
        return self.module(state)

    def action(self, parameters: Parameters, state: States) -> Tensor:
        """See ``Policy``."""
        own = {name: parameters[name] for name in self.names}
        return population_call(self.module, own, limited(parameters, state))


def as_policy(
    part: object, states: int, actions: int, dtype: torch.dtype = torch.float64
) -> Policy:
    """``part`` if it acts by itself, else a ``ModulePolicy`` of it.

    ValueError for what is neither, or lacks ``initial``.
    """
    if isinstance(part, type):
        raise ValueError(f"{part.__name__} is a class, expected an object of it")
    if hasattr(part, "action"):
        if not hasattr(part, "initial"):
            raise ValueError(f"{type(part).__name__} has action(...) but no initial(seeds)")
        return part  # pyright: ignore[reportReturnType]
    if not isinstance(part, nn.Module):
        raise ValueError(
            f"{type(part).__name__} has no action(parameters, state), and is not a torch.nn.Module"
        )
    return ModulePolicy(part, states, actions, dtype)
