r"""Fitting any parameters by gradient steps on the squared one-step error (Fig. 1, step 1).

For models that are not linear in their parameters p.  With the last ``recent`` transitions kept,
each tick takes ``steps`` steps of Adam (Kingma & Ba, 2015) down the mean of

    1/2 |y - y~(s, a; p)|^2

over them, y being what the model's form makes of a transition.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor
from torch.func import grad

from edtorch.model.models import Model
from edtorch.types import Parameters, Transition

FIRST, SECOND = 0.9, 0.999
"""Adam's averages of gradient and squared gradient."""
SMALLEST = 1e-8


@dataclass(frozen=True)
class FittedParameters:
    """Result of one update: parameters, the rule's memory, and y - y~ before it ``[B, n]``."""

    parameters: Parameters
    memory: Parameters
    residual: Tensor


class ParameterFit(Protocol):
    """A rule for fitting any parameters of a model; it says so by ``fits_parameters = True``."""

    @property
    def fits_parameters(self) -> bool:
        """True: it is given the model, not a regressor."""
        ...

    def initial_memory(self, model: Model, parameters: Parameters) -> Parameters:
        """The rule's memory for parameters ``[B, ...]``."""
        ...

    def improve(
        self, model: Model, parameters: Parameters, memory: Parameters, transition: Transition
    ) -> FittedParameters:
        """One tick's learning from one transition of each learner."""
        ...


@dataclass(frozen=True)
class GradientFit:
    """Adam on the squared error over the last transitions.

    rate: Adam's, per step of it; recent: transitions kept; steps: of Adam per tick.
    """

    rate: float = 0.01
    recent: int = 200
    steps: int = 1
    fits_parameters = True
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"rate={self.rate}: expected a number > 0")
        for name in ("recent", "steps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: expected at least one")

    def initial_memory(self, model: Model, parameters: Parameters) -> Parameters:
        """Transitions ``state`` ``[B, recent, n]``, ``action`` ``[B, recent, m]``, ``target``
        ``[B, recent, n]``, their ``count`` ``[B]``; Adam's ``first.NAME`` and ``second.NAME``."""
        some = next(iter(parameters.values()))
        size, zeros = some.shape[0], some.new_zeros
        memory = {
            "state": zeros(size, self.recent, model.states),
            "action": zeros(size, self.recent, model.actions),
            "target": zeros(size, self.recent, model.states),
            "count": torch.zeros(size, dtype=torch.int64, device=some.device),
        }
        for name, p in parameters.items():
            memory[f"first.{name}"] = torch.zeros_like(p)
            memory[f"second.{name}"] = torch.zeros_like(p)
        return memory

    def improve(
        self, model: Model, parameters: Parameters, memory: Parameters, transition: Transition
    ) -> FittedParameters:
        """Keep the transition, then climb down."""
        target = model.target(transition)
        residual = target - model.output(parameters, transition.state, transition.action)
        count = memory["count"]
        place = (count % self.recent).unsqueeze(-1)
        here = (torch.arange(self.recent, device=count.device) == place).unsqueeze(-1)
        kept = {
            name: torch.where(here, new.unsqueeze(-2), memory[name])
            for name, new in (
                ("state", transition.state),
                ("action", transition.action),
                ("target", target),
            )
        }
        known = (count + 1).clamp(max=self.recent).unsqueeze(-1)
        weight = torch.arange(self.recent, device=count.device) < known
        weight = (weight / known).to(target.dtype).mT
        # The population is the last batch dimension of what a model is called with.
        state, action, wanted = (kept[k].movedim(1, 0) for k in ("state", "action", "target"))

        def loss(p: Parameters) -> Tensor:
            error = (wanted - model.output(p, state, action)).square().sum(-1)
            # Learners do not mix: the gradient of the sum holds each one's own.
            return 0.5 * (weight * error).sum()

        first = {name: memory[f"first.{name}"] for name in parameters}
        second = {name: memory[f"second.{name}"] for name in parameters}
        for step in range(1, self.steps + 1):
            slope = grad(loss)(parameters)
            number = (count * self.steps + step).to(target.dtype)
            moved = {}
            for name, p in parameters.items():
                first[name] = torch.lerp(slope[name], first[name], FIRST)
                second[name] = torch.lerp(slope[name].square(), second[name], SECOND)
                # The averages start at zero, and are corrected for it.
                t = number.view(-1, *[1] * (p.ndim - 1))
                mean, square = first[name] / (1 - FIRST**t), second[name] / (1 - SECOND**t)
                moved[name] = p - self.rate * mean / (square.sqrt() + SMALLEST)
            parameters = moved
        averages = {f"first.{k}": v for k, v in first.items()}
        averages |= {f"second.{k}": v for k, v in second.items()}
        return FittedParameters(parameters, kept | {"count": count + 1} | averages, residual)
