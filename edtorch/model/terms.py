"""Terms of a model: products of entries of the lift, some times a learned derivative.

The sets are those of mechanisms.  The accelerations of linked rigid bodies obey M(q) f = tau: the
entries of M, and gravity, are trigonometric in the angles, the forces of Coriolis are those times
products of two rates, and the actions enter linearly.  Written with the other accelerations on the
right side, such an equation is a short sum of products (``Terms.implicit``); solved for each
acceleration, it is a fraction, which a longer sum of products approaches (``Terms.products``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
import torch
from torch import Tensor

from edtorch.law import Law
from edtorch.model.lift import Lift
from edtorch.model.told import Told

Factors = tuple[int, ...]
"""Indices of the entries of a lift that are multiplied, rising; () for the constant term."""


@dataclass(frozen=True, eq=False)
class Terms:
    """phi_k = prod_d A[factors[k, d]], times f_j where derivative[k] = j.

    factors: int64 ``[K, D]``, indices of entries of the lift A, padded with 0, the constant 1;
    derivative: int64 ``[K]``, index 0..L-1 of a learned derivative f_j, -1 for none.  Entries of
    components that are invariant or ignored do not occur.

    The square of a cosine is left out of every set: as sin^2 + cos^2 = 1 it would make the terms
    linearly dependent.
    """

    factors: np.ndarray
    derivative: np.ndarray

    @property
    def count(self) -> int:
        """K."""
        return len(self.derivative)

    @cached_property
    def _columns(self) -> list[Tensor]:
        """Of ``factors``."""
        with torch.inference_mode(False):  # they outlive the call that asks first
            return list(torch.from_numpy(self.factors).T)

    @classmethod
    def implicit(cls, told: Told, lift: Lift, degree: int = 2) -> Terms:
        """Trigonometric monomials up to ``degree``, each times 1, u_k, v_i v_j and f_j; and v.

        v: the components with a learned derivative that are no angles.  Positions that are not
        invariant enter linearly.
        """
        trig = _trigonometric(told, lift, degree)
        rates, actions = _rates(told, lift), _actions(lift)
        with_each = [(), *_products(actions, 1), *_products(rates, 2)]
        plain = [*_crossed(trig, with_each), *_products([*rates, *_linear(told, lift)], 1)]
        implied = [(j, factors) for j in range(len(told.learned)) for factors in trig]
        return _terms([(-1, factors) for factors in plain] + implied)

    @classmethod
    def products(cls, told: Told, lift: Lift, degree: int = 3) -> Terms:
        """Trigonometric monomials up to ``degree``, each times 1, v_i, v_i v_j and u_k.

        v and positions as for ``implicit``.
        """
        trig = _trigonometric(told, lift, degree)
        rates = _rates(told, lift)
        with_each = [(), *_products(rates, 1), *_products(rates, 2), *_products(_actions(lift), 1)]
        plain = [*_crossed(trig, with_each), *_products(_linear(told, lift), 1)]
        return _terms([(-1, factors) for factors in plain])

    @classmethod
    def monomials(cls, told: Told, lift: Lift, degree: int = 4) -> Terms:
        """All monomials of the lift's entries up to ``degree``."""
        entries = [*lift.entries_of(told.acting), *_actions(lift)]
        return _terms([(-1, factors) for factors in _monomials(lift, sorted(entries), degree)])

    @classmethod
    def listed(cls, terms: Sequence[tuple[int, Factors]]) -> Terms:
        """These, each with the index of its learned derivative, -1 for none."""
        return _terms(terms)

    @classmethod
    def of_state(
        cls, lift: Lift, components: Sequence[int], degree: int, *, odd: bool = False
    ) -> Terms:
        """All monomials up to ``degree`` of the entries of these components of the state, without
        the constant; odd: those alone that change their sign with the state.  For policies."""
        entries = lift.entries_of(components)
        cosines = {int(k) + 1 for k in lift.at[lift.angle]}

        def wanted(factors: Factors) -> bool:
            return sum(k not in cosines for k in factors) % 2 == 1 if odd else bool(factors)

        return _terms([(-1, f) for f in _monomials(lift, entries, degree) if wanted(f)])

    def __call__(self, lifted: Tensor) -> Tensor:
        """``[*batch, K]``, without the factors f_j, of A ``[*batch, size]``."""
        found = lifted[..., self._columns[0]]
        for column in self._columns[1:]:
            found = found * lifted[..., column]
        return found

    def law(self) -> Law:
        """``__call__`` on numpy, ``[size] -> [K]``."""
        columns = np.ascontiguousarray(self.factors.T)
        return lambda lifted: np.multiply.reduce(lifted[columns], axis=0)

    def jacobian(self, lifted: Tensor, slope: Tensor) -> Tensor:
        """Derivatives ``[*batch, K, p]``, without the factors f_j, of A with slope dA ``[*batch,
        size, p]``: the product rule."""
        parts = [lifted[..., column] for column in self._columns]
        total = slope.new_zeros(*lifted.shape[:-1], self.count, slope.shape[-1])
        for d, column in enumerate(self._columns):
            others = torch.ones_like(parts[d])
            for part in parts[:d] + parts[d + 1 :]:
                others = others * part
            total = total + others.unsqueeze(-1) * slope[..., column, :]
        return total


def _terms(found: Sequence[tuple[int, Factors]]) -> Terms:
    width = max(1, *(len(factors) for _, factors in found))
    table = np.zeros((len(found), width), dtype=np.int64)
    for row, (_, factors) in zip(table, found, strict=True):
        row[: len(factors)] = factors
    return Terms(table, np.array([j for j, _ in found], dtype=np.int64))


def _actions(lift: Lift) -> list[int]:
    return list(range(lift.action_at, lift.size))


def _rates(told: Told, lift: Lift) -> list[int]:
    return [int(lift.at[i]) for i in told.acting if i in told.learned and not told.angle[i]]


def _linear(told: Told, lift: Lift) -> list[int]:
    return [int(lift.at[i]) for i in told.acting if i not in told.learned and not told.angle[i]]


def _trigonometric(told: Told, lift: Lift, degree: int) -> list[Factors]:
    entries = lift.entries_of([i for i in told.acting if told.angle[i]])
    return _monomials(lift, entries, degree)


def _monomials(lift: Lift, entries: Sequence[int], degree: int) -> list[Factors]:
    """Products of up to ``degree`` entries, without squares of cosines."""
    if degree < 0:
        raise ValueError(f"degree={degree}: expected 0 or more")
    cosines = {int(k) + 1 for k in lift.at[lift.angle]}
    return [
        factors
        for size in range(degree + 1)
        for factors in _products(entries, size)
        if all(factors.count(k) < 2 for k in cosines)
    ]


def _products(entries: Iterable[int], size: int) -> list[Factors]:
    return list(combinations_with_replacement(entries, size))


def _crossed(left: Sequence[Factors], right: Sequence[Factors]) -> list[Factors]:
    return [(*b, *a) for a in right for b in left]
