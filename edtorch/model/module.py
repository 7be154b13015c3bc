"""Any ``nn.Module`` of state and action as a model, nonlinear in its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import torch
from torch import Tensor, nn

from edtorch.functional import population_call
from edtorch.initial import drawn
from edtorch.model.models import Derivative, Dynamics, Model, NextState
from edtorch.seeding import Purpose
from edtorch.shapes import Actions, Features, States
from edtorch.types import Parameters


class ModuleModel(Dynamics):
    """y~ = module(s, a), for one learner's ``[*more, n]`` and ``[*more, m]``, all scaled.

    The module is copied, in the dtype of ``period``.  Its parameters that require a gradient are
    fitted (``edtorch.model.fit_gradient``); each seed draws its own by the module's initialisers
    (``edtorch.initial.drawn``).  ``DerivativeModule`` and ``NextStateModule`` say what y~ is.
    ValueError for a module without such parameters, or whose output has another shape.
    """

    def __init__(self, module: nn.Module, states: int, actions: int, period: Tensor) -> None:
        super().__init__(states, actions, period)
        self.module = deepcopy(module).to(period.dtype)
        self.names = [n for n, p in self.module.named_parameters() if p.requires_grad]
        label = type(module).__name__
        if not self.names:
            raise ValueError(f"{label} has no parameter that requires a gradient")
        for lead in ((), (3,)):
            state, action = period.new_zeros(*lead, states), period.new_zeros(*lead, actions)
            with torch.no_grad():
                found = tuple(self.module(state, action).shape)
            if found != (*lead, states):
                raise ValueError(
                    f"{label} takes states of shape {tuple(state.shape)} and actions of shape"
                    f" {tuple(action.shape)} to {found}, expected {(*lead, states)}"
                )

    @property
    def regressors(self) -> int:
        """n + m."""
        return self.states + self.actions

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """Drawn for each seed."""
        return drawn(self.module, seeds, Purpose.MODEL)

    def phi(self, state: States, action: Actions) -> Features:
        """State and action, ``[*batch, n + m]``."""
        return torch.cat([state, action], dim=-1)

    def output(self, parameters: Parameters, state: States, action: Actions) -> Tensor:
        """y~ ``[*more, B, n]``."""
        own = {name: parameters[name] for name in self.names}
        return population_call(self.module, own, state, action)


class DerivativeModule(ModuleModel, Derivative):
    """ds/dt = module(s, a); rates and noise are per second."""

    def next(self, parameters: Parameters, state: States, action: Actions, dt: float) -> Tensor:
        """mu~: one Euler step of ``dt`` seconds, ``[*more, B, n]``."""
        return self.advance(state, self.output(parameters, state, action), dt)


class NextStateModule(ModuleModel, NextState):
    """s' = module(s, a); rates and noise are per step."""

    def next(self, parameters: Parameters, state: States, action: Actions, dt: float) -> Tensor:
        """mu~: the next state, ``[*more, B, n]``."""
        return self.advance(state, self.output(parameters, state, action), dt)


def as_model(part: object, states: int, actions: int, period: Tensor) -> Model:
    """``part`` if it is a model by itself, else one made of a module of state and action.

    A module with the attribute ``integrates = False`` gives the next state; else its output is the
    derivative.  ValueError for what is neither.
    """
    if hasattr(part, "next"):
        return part  # pyright: ignore[reportReturnType]
    if not isinstance(part, nn.Module):
        raise ValueError(
            f"{type(part).__name__} has no next(parameters, state, action, dt), and is not a"
            " torch.nn.Module"
        )
    form = DerivativeModule if getattr(part, "integrates", True) else NextStateModule
    return form(part, states, actions, period)
