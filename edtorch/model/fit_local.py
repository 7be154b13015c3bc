r"""Least squares near a target: samples close to where a system is to be held count most.

A smooth system is linear only locally: at the distance d from the target the error of the best
linear model grows as d^2 and its variance as d^4.  A sample is therefore weighted with
(h^2 + d^2)^-power, power 2 being the inverse of that variance, so that samples from far away lose
their influence as nearer ones arrive.  A narrow bandwidth h wastes samples where noise dominates, a
wide one keeps the error of the linearisation.  Several bandwidths are fitted side by side, and the
one whose predictions of samples not yet seen were best near the target is used (prequential
validation; Dawid, "Statistical theory: the prequential approach", 1984; local regression: Cleveland
& Devlin, "Locally weighted regression", 1988).  Where several are about as good, the widest of them
is used, since it rests on the most samples (compare the one-standard-error rule of Breiman et al.,
"Classification and regression trees", 1984).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.fit import Fitted
from edtorch.types import Parameters

_WORST = 100.0
"""Greatest relative squared error of one prediction: an outlier must not decide alone."""


@dataclass(frozen=True)
class LocalLeastSquares:
    r"""Weighted ridge regression on phi = (1, s, a), one for each bandwidth h.

        w_h = ((h^2 + d^2) / (h^2 + 1))^-power,  d^2 = mean_i e_i^2 / spread_i^2,
        spread_i^2 = mean of e_i^2,  e_i = s_i - centre_i,
        W_h = C' (A + ridge diag A)^-1,  A = sum w_h phi phi',  C = sum w_h phi y'.

    All sums run over the samples so far, the present one included; none is forgotten.  centre: the
    target of the components that have one, else their weighted mean.  The ridge is relative to the
    size of each feature, so that scales and units do not matter.

    phi may have more features after 1 and s.  states n; target: wanted values by index of the
    component, scaled units; bandwidths h: in spreads; tie: scores within the share
    tie * k / (samples so far) of the best count as equal, k being the number of features.  Raises
    ValueError for settings out of range.
    """

    states: int
    target: Mapping[int, float]
    bandwidths: Sequence[float] = (0.1, 0.3, 1.0, 1000.0)
    power: float = 2.0
    ridge: float = 1e-6
    tie: float = 2.0

    reads_state: ClassVar[bool] = True
    """The features must begin with 1 and the state."""

    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.bandwidths or not all(h > 0 for h in self.bandwidths):
            raise ValueError(
                f"bandwidths={list(self.bandwidths)}: expected one or more numbers > 0"
            )
        if not self.ridge > 0:
            raise ValueError(f"ridge={self.ridge}: expected a number > 0")
        if not self.power >= 0:
            raise ValueError(f"power={self.power}: expected a number >= 0")
        if not self.tie >= 0:
            raise ValueError(f"tie={self.tie}: expected a number >= 0")
        for index in self.target:
            if not 0 <= index < self.states:
                raise ValueError(f"target[{index}]: expected an index below {self.states}")

    def initial(self, weight: Tensor) -> Parameters:
        """For each bandwidth (J of them) A ``[*batch, J, k, k]``, C ``[*batch, J, k, n]``, W
        ``[*batch, J, n, k]`` and ``score`` ``[*batch, J]``, the weighted sum of squared errors of
        its predictions, relative to ``least`` ``[*batch, n]``; ``squares`` and ``most``
        ``[*batch, n]``: sum and maximum of e^2; ``count`` ``[*batch]``; ``total`` ``[*batch]`` and
        ``sum`` ``[*batch, n]`` of w and w s for the narrowest bandwidth; ``power``
        ``[*batch, J, n]`` and ``mass`` ``[*batch, J]``, the sums of w y^2 and of w; ``error``
        ``[*batch, n]``, the weighted root mean square residual of the weights in use."""
        batch, (n, k) = weight.shape[:-2], weight.shape[-2:]
        zeros, J = weight.new_zeros, len(self.bandwidths)
        return {
            "A": zeros(*batch, J, k, k),
            "C": zeros(*batch, J, k, n),
            "W": zeros(*batch, J, n, k),
            "score": zeros(*batch, J),
            "least": zeros(*batch, n),
            "squares": zeros(*batch, n),
            "most": zeros(*batch, n),
            "count": zeros(batch),
            "total": zeros(batch),
            "sum": zeros(*batch, n),
            "power": zeros(*batch, J, n),
            "mass": zeros(*batch, J),
            "error": zeros(*batch, n),
        }

    def update(
        self, weight: Tensor, memory: Parameters, phi: Tensor, y: Tensor, unit: Tensor
    ) -> Fitted:
        """Score the predictions, add the sample, solve, choose a bandwidth."""
        residual = y - matvec(weight, phi)
        state = phi[..., 1 : 1 + self.states]
        count = memory["count"] + 1
        square = (state - self._centre(memory, state)).square()
        squares = memory["squares"] + square
        # A component that has never moved does not contribute to the distance.
        distance = _ratio(square, squares / count.unsqueeze(-1)).mean(-1)
        bandwidths = torch.tensor(self.bandwidths, dtype=phi.dtype, device=phi.device).square()
        w = ((bandwidths + distance.unsqueeze(-1)) / (bandwidths + 1)) ** -self.power
        # Predictions count by how near the target they are, for all bandwidths alike.
        local = (bandwidths.min() + distance) ** -self.power
        errors = (y.unsqueeze(-2) - matvec(memory["W"], phi.unsqueeze(-2))).square()
        least = memory["least"] + local.unsqueeze(-1) * errors.amin(-2)
        relative = _ratio(errors, (least / count.unsqueeze(-1)).unsqueeze(-2)).clamp(max=_WORST)
        # Before that many samples every fit interpolates.
        scored = local * (count > phi.shape[-1])
        score = memory["score"] + scored.unsqueeze(-1) * relative.mean(-1)
        weighted = w.unsqueeze(-1) * phi.unsqueeze(-2)
        A = memory["A"] + weighted.unsqueeze(-1) * phi[..., None, None, :]
        C = memory["C"] + weighted.unsqueeze(-1) * y[..., None, None, :]
        W = self._solved(A, C)
        best = self._best(score, count, phi.shape[-1])[..., None, None, None]
        chosen = torch.take_along_dim(W, best, dim=-3).squeeze(-3)
        # sum w (y - W phi)^2 = sum w y^2 - W_i. C_.i at the minimum.
        power = memory["power"] + w.unsqueeze(-1) * y.square().unsqueeze(-2)
        mass = memory["mass"] + w
        mean = ((power - (W.mT * C).sum(-2)) / mass.unsqueeze(-1)).clamp(min=0)
        fresh = {
            "A": A,
            "C": C,
            "W": W,
            "score": score,
            "least": least,
            "squares": squares,
            "most": torch.maximum(memory["most"], square),
            "count": count,
            "total": memory["total"] + local,
            "sum": memory["sum"] + local.unsqueeze(-1) * state,
            "power": power,
            "mass": mass,
            "error": torch.take_along_dim(mean, best.squeeze(-1), dim=-2).squeeze(-2).sqrt(),
        }
        return Fitted(chosen, fresh, residual)

    def describe(self, memory: Parameters) -> Parameters:
        """What a value path may use beside the weights, each ``[*batch, n]``, scaled units:
        ``centre``; ``excursion``, the greatest |s - centre| so far, and ``spread``, its root mean
        square; ``error``, the weighted root mean square residual of y; and ``count``
        ``[*batch]``, the number of samples."""
        centre = self._centre(memory, torch.zeros_like(memory["sum"]))
        count = memory["count"].clamp(min=1)
        return {
            "centre": centre,
            "excursion": memory["most"].sqrt(),
            "spread": (memory["squares"] / count.unsqueeze(-1)).sqrt(),
            "error": memory["error"],
            "count": memory["count"],
        }

    def _best(self, score: Tensor, count: Tensor, unknowns: int) -> Tensor:
        """``[*batch]``: the widest bandwidth whose score is not significantly above the best."""
        close = 1 + self.tie * unknowns / count
        near = score <= close.unsqueeze(-1) * score.amin(-1, keepdim=True)
        widths = torch.tensor(self.bandwidths, dtype=score.dtype, device=score.device)
        return torch.where(near, widths, 0.0).argmax(-1)

    def _centre(self, memory: Parameters, otherwise: Tensor) -> Tensor:
        """``[*batch, n]``; otherwise: of components without a target before the first sample."""
        total = memory["total"].unsqueeze(-1)
        mean = torch.where(total > 0, _ratio(memory["sum"], total), otherwise)
        columns = list(mean.unbind(-1))
        for index, value in self.target.items():
            columns[index] = torch.full_like(columns[index], value)
        return torch.stack(columns, dim=-1)

    def _solved(self, A: Tensor, C: Tensor) -> Tensor:
        """W ``[*batch, J, n, k]``, solved with every feature divided by its size."""
        size = A.diagonal(dim1=-2, dim2=-1).sqrt()
        size = torch.where(size > 0, size, 1.0)
        scaled = A / (size.unsqueeze(-1) * size.unsqueeze(-2))
        eye = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)
        found = torch.linalg.solve_ex(scaled + self.ridge * eye, C / size.unsqueeze(-1)).result
        return (found / size.unsqueeze(-1)).mT


def _ratio(a: Tensor, b: Tensor) -> Tensor:
    """a / b, 0 where b is not above 0."""
    return torch.where(b > 0, a / torch.where(b > 0, b, 1.0), 0.0)
