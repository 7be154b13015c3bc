"""Policy steps: theta up the gradient of the value (Fig. 1, step 7; section 4).

``unit`` turns the rate of the configuration into the rate of one update, as in
``edtorch.model.fit``, ``dt_per_learner`` included.  Gradients and parameters have the population as
their leading axis; norms are per learner, over all policy parameters together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from edtorch.shapes import Rows
from edtorch.types import Parameters


def gradient_norm(gradient: Parameters) -> Rows:
    """|dV/dtheta| of each learner, ``[B]``."""
    squares = [g.square().sum(tuple(range(1, g.ndim))) for g in gradient.values()]
    return torch.stack(squares).sum(0).sqrt()


class Step(Protocol):
    """A rule that moves the policy; it may keep a memory per learner."""

    def initial(self, policy: Parameters) -> Parameters:
        """The rule's memory."""
        ...

    def __call__(
        self, policy: Parameters, gradient: Parameters, memory: Parameters, unit: Tensor
    ) -> tuple[Parameters, Parameters]:
        """The moved parameters and the new memory."""
        ...


def _ascend(policy: Parameters, gradient: Parameters, rate: Tensor) -> Parameters:
    return {
        name: theta + rate.reshape(rate.shape + (1,) * (theta.ndim - rate.ndim)) * gradient[name]
        for name, theta in policy.items()
    }


@dataclass(frozen=True)
class SaturatedStep:
    """theta += alpha unit g / (beta + |g|) (section 4): bounded far away, plain ascent near by."""

    alpha: float
    beta: float
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.alpha >= 0:
            raise ValueError(f"alpha={self.alpha}: expected a number >= 0")
        if not self.beta > 0:
            raise ValueError(f"beta={self.beta}: expected a number > 0")

    def initial(self, policy: Parameters) -> Parameters:
        """No memory."""
        return {}

    def __call__(
        self, policy: Parameters, gradient: Parameters, memory: Parameters, unit: Tensor
    ) -> tuple[Parameters, Parameters]:
        """One saturated step."""
        rate = self.alpha * unit / (self.beta + gradient_norm(gradient))
        return _ascend(policy, gradient, rate), memory


@dataclass(frozen=True)
class DecayingStep:
    """``SaturatedStep`` with alpha / (1 + t / decay) for alpha, t being the units climbed so far.

    A policy whose steps do not shrink wanders about its optimum, and its gains may grow for ever.
    The sum of the steps is still unbounded, so that any optimum stays within reach.
    decay: units (seconds, where rates are per second) after which the step is halved.
    """

    alpha: float
    beta: float
    decay: float
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        SaturatedStep(self.alpha, self.beta)
        if not self.decay > 0:
            raise ValueError(f"decay={self.decay}: expected a number > 0")

    def initial(self, policy: Parameters) -> Parameters:
        """The units climbed, ``[B]``."""
        first = next(iter(policy.values()))
        return {"climbed": first.new_zeros(first.shape[0])}

    def __call__(
        self, policy: Parameters, gradient: Parameters, memory: Parameters, unit: Tensor
    ) -> tuple[Parameters, Parameters]:
        """One saturated step, shorter than the one before."""
        alpha = self.alpha / (1 + memory["climbed"] / self.decay)
        rate = alpha * unit / (self.beta + gradient_norm(gradient))
        return _ascend(policy, gradient, rate), {"climbed": memory["climbed"] + unit}


@dataclass(frozen=True)
class PlainStep:
    """theta += alpha unit g (Fig. 1, step 7)."""

    alpha: float
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.alpha >= 0:
            raise ValueError(f"alpha={self.alpha}: expected a number >= 0")

    def initial(self, policy: Parameters) -> Parameters:
        """No memory."""
        return {}

    def __call__(
        self, policy: Parameters, gradient: Parameters, memory: Parameters, unit: Tensor
    ) -> tuple[Parameters, Parameters]:
        """One step of gradient ascent."""
        norm = gradient_norm(gradient)
        return _ascend(policy, gradient, self.alpha * unit * torch.ones_like(norm)), memory


@dataclass(frozen=True)
class FullStep:
    """theta += g, for directions that lead to the very place:
    ``edtorch.value.linear.regulator``."""

    dt_per_learner: ClassVar[bool] = True

    def initial(self, policy: Parameters) -> Parameters:
        """No memory."""
        return {}

    def __call__(
        self, policy: Parameters, gradient: Parameters, memory: Parameters, unit: Tensor
    ) -> tuple[Parameters, Parameters]:
        """The whole way."""
        return {name: theta + gradient[name] for name, theta in policy.items()}, memory
