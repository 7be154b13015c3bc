"""Ridge least squares in information form: sums of products, solved now and then.

A rule of ``edtorch.model.fit`` for many features.  A recursion for the weights' covariance costs
k^2 for every sample and loses its positive definiteness in the long run; sums keep theirs, and a
block of samples enters them by one product of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.fit import Fitted
from edtorch.shapes import Features, States, Weights
from edtorch.types import Parameters, select


@dataclass(frozen=True)
class Ridge:
    """W = argmin sum |y - W phi|^2 + penalty |W|^2 over all samples so far.

    The samples enter the sums A = sum phi phi' and B = sum phi y' in blocks of ``every``, and W is
    solved for after each block; after ``settled`` samples, when one block changes little, only
    after every ``later`` samples (a multiple of ``every``).
    """

    penalty: float = 0.01
    every: int = 25
    later: int = 100
    settled: int = 3000
    dt_per_learner: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.penalty > 0:
            raise ValueError(f"penalty={self.penalty}: expected a number > 0")
        if self.every < 1:
            raise ValueError(f"every={self.every}: expected at least one sample")
        if self.later < 1 or self.later % self.every:
            raise ValueError(f"later={self.later}: expected a multiple of every, {self.every}")
        if self.settled < 0:
            raise ValueError(f"settled={self.settled}: expected 0 samples or more")

    def initial(self, weight: Tensor) -> Parameters:
        """A ``[*batch, k, k]``, B ``[*batch, k, n]``, count ``[*batch]``, and the block being
        filled: rows ``[*batch, every, k]``, targets ``[*batch, every, n]``."""
        batch, (n, k) = weight.shape[:-2], weight.shape[-2:]
        return {
            "A": weight.new_zeros(*batch, k, k),
            "B": weight.new_zeros(*batch, k, n),
            "rows": weight.new_zeros(*batch, self.every, k),
            "targets": weight.new_zeros(*batch, self.every, n),
            "count": torch.zeros(batch, dtype=torch.int64, device=weight.device),
        }

    def update(
        self, weight: Weights, memory: Parameters, phi: Features, y: States, unit: Tensor
    ) -> Fitted:
        """Put the sample into the block; at its end, solve.

        Whether it is the end is asked of a tensor, for the alternative would solve at every sample.
        """
        residual = y - matvec(weight, phi)
        count = memory["count"] + 1
        place = ((count - 1) % self.every).unsqueeze(-1)
        here = (torch.arange(self.every, device=phi.device) == place).unsqueeze(-1)
        rows = torch.where(here, phi.unsqueeze(-2), memory["rows"])
        targets = torch.where(here, y.unsqueeze(-2), memory["targets"])
        memory = memory | {"rows": rows, "targets": targets, "count": count}
        full = count % self.every == 0
        if bool(full.any()):
            A, B = memory["A"], memory["B"]
            if bool(full.all()):
                # The usual case, without a copy of A to choose from: A is what takes the time here.
                A, B = torch.baddbmm(A, rows.mT, rows), torch.baddbmm(B, rows.mT, targets)
            else:
                A, B = select(full, A + rows.mT @ rows, A), select(full, B + rows.mT @ targets, B)
            memory = memory | {"A": A, "B": B}
            due = full & ((count <= self.settled) | (count % self.later == 0))
            if bool(due.any()):
                weight = select(due, self.solve(weight, A, B), weight)
        return Fitted(weight, memory, residual)

    def solve(self, weight: Tensor, A: Tensor, B: Tensor) -> Tensor:
        """((A + penalty I)^-1 B)' ``[*batch, n, k]``; ``weight`` where rounding leaves no such."""
        eased = A.clone()
        eased.diagonal(dim1=-2, dim2=-1).add_(self.penalty)
        factor, failed = torch.linalg.cholesky_ex(eased)
        # Two triangles, which take a quarter of the time of cholesky_solve.
        half = torch.linalg.solve_triangular(factor, B, upper=False)
        solved = torch.linalg.solve_triangular(factor.mT, half, upper=True)
        return select(failed == 0, solved.mT, weight)
