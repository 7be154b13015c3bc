r"""The jump of the rates at a strike: a regression on features before it, with the learned inertia.

An impact of a mechanism changes momenta by an impulse that is linear in the velocities before it
(Hurmuzlu & Marghitu, "Rigid body collisions of planar kinematic chains", 1994), so that, with
I - N of the free model (``edtorch.model.mechanism``) at the positions of the strike,

    (I - N) v+ = W phi(q, v-) + sum_k (I - N) A_k impulse_k.

The last sum is of the stops that are shut, whose impulses act along A_k = df/du_column(k) and are
not measured: rates are compared across these directions alone.  v+ is what is read, so the
regression is of v+ on (I - N)^{-1} W phi, all outputs in one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.model.evidence import Evidence, ard
from edtorch.model.mechanism import Structure, coupled, derivative_jacobian
from edtorch.model.terms import Terms
from edtorch.model.ties import Ties

TAIL = 3.0
"""Standard deviations at which a strike weighs half."""


@dataclass(frozen=True)
class Kinks:
    """N strikes, scaled: states ``[N, n]`` just before, already relabelled, and just after; held:
    bool ``[N, K]``, the stops that are shut after it."""

    before: Tensor
    after: Tensor
    held: Tensor


@dataclass(frozen=True, eq=False)
class Impact:
    """v+ = (I - N)^{-1} W phi, for ``L`` rates: weight ``[L, K]`` of terms without derivatives.

    noise: standard deviation of a rate's error after a strike, scaled; count: strikes used.
    """

    terms: Terms
    weight: Tensor
    noise: float
    count: int

    def __call__(self, structure: Structure, weight: Tensor, before: Tensor) -> Tensor:
        """v+ ``[*batch, L]`` without impulses of stops, from relabelled states ``[*batch, n]``."""
        phi = self.terms(structure.lift.of_state(before))
        matrix = coupled(structure, weight, before)
        return torch.linalg.solve(matrix, (phi @ self.weight.mT).unsqueeze(-1)).squeeze(-1)


def fit_impact(
    structure: Structure,
    weight: Tensor,
    kinks: Kinks,
    columns: Tensor,
    terms: Terms,
    ties: Ties,
    passes: int = 3,
    evidence: Evidence = ard,
) -> Impact:
    """The map of the strikes ``kinks`` for the free model with ``weight`` ``[L, K]``.

    columns: int64 ``[K]``, the action of each stop.  terms, ties: of phi, such as
    ``edtorch.model.chain.impact_terms``.  In each pass after the first, strikes that fit badly
    weigh less.  Raises FitError for fewer strikes than a row has features.
    """
    count, outputs = len(kinks.before), len(structure.learned)
    share, allowed = torch.from_numpy(ties.share), torch.from_numpy(ties.allowed)
    least = int(allowed.sum(1).max())
    if count * outputs < int(allowed.sum()):
        raise FitError(
            f"strikes: got {count}, expected at least {least} to learn what they do; let more be"
            " tried first"
        )
    feature = terms(structure.lift.of_state(kinks.before)) @ share.mT
    across = _across(structure, weight, kinks, columns)
    inverse = torch.linalg.inv(coupled(structure, weight, kinks.before))
    # [N, L, L, F]: by output of v+, and by row and feature of W.
    design = (across @ inverse).unsqueeze(-1) * feature[:, None, None, :]
    X = design[:, :, allowed].flatten(0, 1)
    learned = torch.from_numpy(structure.learned)
    y = (across @ kinks.after[:, learned].unsqueeze(-1)).flatten().unsqueeze(0)
    weights = torch.ones_like(y)
    everything = torch.ones(1, X.shape[1], dtype=torch.bool)
    found = evidence(X, y, weights, everything)
    for _ in range(passes - 1):
        left = (y - found.weight @ X.mT).view(count, outputs)
        size = left.square().mean(-1).sqrt()
        deviation = (1.2 * size.median()).clamp(min=torch.finfo(size.dtype).tiny)
        trust = 1 / (1 + (size / (TAIL * deviation)).square())
        weights = trust.repeat_interleave(outputs).unsqueeze(0)
        found = evidence(X, y, weights, everything)
    own = torch.zeros(allowed.shape, dtype=X.dtype)
    own[allowed] = found.weight[0]
    return Impact(terms, own @ share, float(found.noise.sqrt()), count)


def no_jump(structure: Structure, weight: Tensor) -> Impact:
    """Rates that are the same after a strike: W phi = (I - N) v, for the free model with ``weight``
    ``[L, K]``."""
    terms, rates = structure.terms, structure.lift.at[structure.learned]
    own: dict[tuple[int, ...], np.ndarray] = {}

    def add(output: int, factors: tuple[int, ...], value: float) -> None:
        own.setdefault(factors, np.zeros(len(rates)))[output] += value

    for output, rate in enumerate(rates.tolist()):
        add(output, (rate,), 1.0)
    for k, j in enumerate(terms.derivative.tolist()):
        if j >= 0:
            entries = (*(int(entry) for entry in terms.factors[k] if entry), int(rates[j]))
            for output, value in enumerate(weight[:, k].tolist()):
                add(output, tuple(sorted(entries)), -value)
    listed = Terms.listed([(-1, factors) for factors in own])
    return Impact(listed, torch.from_numpy(np.stack(list(own.values()), -1)), 0.0, 0)


def _across(structure: Structure, weight: Tensor, kinks: Kinks, columns: Tensor) -> Tensor:
    """``[N, L, L]``: the projection of rates across the directions A_k of the stops held."""
    n = kinks.after.shape[-1]
    action = kinks.after.new_zeros(len(kinks.after), structure.lift.actions)
    learned = torch.from_numpy(structure.learned)
    by = derivative_jacobian(structure, weight, kinks.after, action)[:, learned]
    along = by[:, :, n + columns] * kinks.held.unsqueeze(-2)
    eye = torch.eye(len(learned), dtype=weight.dtype)
    return eye - along @ torch.linalg.pinv(along)
