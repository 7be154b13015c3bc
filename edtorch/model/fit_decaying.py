"""A rule of ``edtorch.model.fit`` that calms down: quick while nothing is known, quiet later on.

A gradient rule with a constant rate never comes to rest: what it has learned shakes with every
sample, the more the faster it learns.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.model.fit import Fit, Fitted
from edtorch.shapes import Features, States, Weights
from edtorch.types import Parameters


@dataclass(frozen=True)
class DecayingFit:
    """``rule`` with its rate divided by 1 + t / decay, t being the units that it has learned for.

    The sum of the rates is unbounded, so that nothing stays out of reach.  decay: units (seconds,
    where rates are per second) after which the rate is halved.
    """

    rule: Fit
    decay: float

    def __post_init__(self) -> None:
        if not self.decay > 0:
            raise ValueError(f"decay={self.decay}: expected a number > 0")

    @property
    def dt_per_learner(self) -> bool:
        """As the rule."""
        return getattr(self.rule, "dt_per_learner", False)

    def initial(self, weight: Tensor) -> Parameters:
        """The rule's memory, and the units ``learned`` for, ``[*batch]``."""
        return self.rule.initial(weight) | {"learned": weight.new_zeros(weight.shape[:-2])}

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """One step, smaller than the one before."""
        learned = memory["learned"]
        # One number for each component of phi, which is what rules multiply their rate with.
        slowed = (unit / (1 + learned / self.decay)).unsqueeze(-1)
        rest = {name: m for name, m in memory.items() if name != "learned"}
        fitted = self.rule.update(weight, rest, phi, y, slowed)
        now = fitted.memory | {"learned": learned + unit}
        return Fitted(fitted.weight, now, fitted.residual)
