"""Settings that change while a learner gets older."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.shapes import Rows


@dataclass(frozen=True)
class Annealed:
    """final + (start - final) exp(-t / decay), t being the learner's age.

    decay: in ticks, as the age is.
    """

    start: float
    final: float
    decay: float

    def __post_init__(self) -> None:
        if not self.decay > 0:
            raise ValueError(f"decay={self.decay}: expected a number > 0")

    def __call__(self, ticks: Tensor, dtype: torch.dtype) -> Rows:
        """At the ages ``ticks`` ``[*batch]``, int64."""
        left = torch.exp(ticks.to(dtype) * (-1 / self.decay))
        return self.final + (self.start - self.final) * left
