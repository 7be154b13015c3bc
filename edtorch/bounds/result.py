"""What the error recursion returns: numbers that know whether they are a certificate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from edtorch.bounds.constants import NotCertified

Standing = Literal["certified", "estimate"]


@dataclass(frozen=True)
class ErrorBounds:
    """Bounds along T + 1 beliefs, each a tuple by step.

    mean: |epsilon^s_t|; cov: |epsilon^Sigma_t|_F; reward: |epsilon^r_t|; second_moment D_2 and
    fourth_moment D_4 of |s_t - s~_t|.  value_summed: the weighted sum of the rewards' bounds
    (Theorem 4, tighter); value_adjoint: its adjoint form, usually smaller.  Numbers beyond
    float64's range are infinite.

    standing: "certified" if every constant is a true supremum, "estimate" otherwise, with the
    reasons.  A certificate holds in exact arithmetic: the recursion's own rounding, about 1e-15
    relative per step, is not accounted for.
    """

    standing: Standing
    reasons: tuple[str, ...]
    mean: tuple[float, ...]
    cov: tuple[float, ...]
    reward: tuple[float, ...]
    second_moment: tuple[float, ...]
    fourth_moment: tuple[float, ...]
    value_summed: float
    value_adjoint: float

    @property
    def value(self) -> float:
        """The smaller of the two forms; a bound or an estimate, as ``standing`` says."""
        return min(self.value_summed, self.value_adjoint)

    def certified_value(self) -> float:
        """The bound of |V - V'|.  Raises NotCertified, with the reasons, if it is an estimate."""
        if self.standing != "certified":
            raise NotCertified(f"the value's bound is an estimate: {'; '.join(self.reasons)}")
        return self.value

    def __str__(self) -> str:
        label = "bound (certified)" if self.standing == "certified" else "estimate"
        return f"value error {label}: {self.value:.3g}"
