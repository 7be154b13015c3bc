"""Stationary policies whose actions are bounded by a smooth function of a raw action."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import final

import numpy as np
from torch import Tensor

from edtorch.law import Arrays, Law
from edtorch.model.terms import Terms
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


class BoundedPolicy(ABC):
    """pi(s) = squash(z(s)), z the raw action."""

    def __init__(self, squash: Squash) -> None:
        self.squash = squash

    @property
    def label(self) -> str:
        """What a saved policy is called."""
        return type(self).__name__

    @property
    def linear_terms(self) -> Terms | None:
        """phi where z = weight . phi(A(s)) with the parameter ``weight`` ``[B, m, F]`` alone, as
        compiled descents take it; None elsewhere."""
        return None

    @abstractmethod
    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The first parameters, one set per seed."""

    @abstractmethod
    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """``count`` sets of parameters to begin a search from; spread: of the raw actions."""

    def raw_law(self, parameters: Arrays) -> Law | None:
        """``raw`` of one state ``[n]`` (``edtorch.law``); None if it is left to torch."""
        return None

    @abstractmethod
    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """z, ``[*more, B, n] -> [*more, B, m]``."""

    @final
    def action(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """``[*more, B, n] -> [*more, B, m]``."""
        return self.squash(self.raw(parameters, state))

    @final
    def law(self, parameters: Arrays) -> Law | None:
        """``action`` of one state ``[n]`` (``edtorch.law``)."""
        raw = self.raw_law(parameters)
        return None if raw is None else self.squash.law(raw)


@final
class OddPolicy(BoundedPolicy):
    """z(s) = (z'(s) - z'(-s)) / 2 of another policy: it acts the other way in the mirror image."""

    def __init__(self, policy: BoundedPolicy) -> None:
        super().__init__(policy.squash)
        self.policy = policy

    @property
    def label(self) -> str:
        """Of the other policy, said to be odd."""
        return f"Odd{self.policy.label}"

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The other policy's."""
        return self.policy.initial(seeds)

    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """The other policy's."""
        return self.policy.random(count, spread, generator)

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """See ``BoundedPolicy``."""
        return (self.policy.raw(parameters, state) - self.policy.raw(parameters, -state)) / 2

    def raw_law(self, parameters: Arrays) -> Law | None:
        """See ``BoundedPolicy``."""
        raw = self.policy.raw_law(parameters)
        return None if raw is None else lambda state: (raw(state) - raw(-state)) / 2
