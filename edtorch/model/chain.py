r"""Terms of planar chains of rigid links whose angles are measured from one direction in space.

With such angles q_i, rates v_i and actions u, Lagrange's equations of links joined by pivots are

    sum_j D_ij (cos(q_i - q_j) f_j + sin(q_i - q_j) v_j^2) = G_i sin q_i + sum_k B_ik u_k,

whatever the number of links and branches (Westervelt et al., "Feedback control of dynamic bipedal
robot locomotion", 2007, appendix B): in contrast to ``edtorch.model.terms.Terms.implicit`` the
number of weights grows with the square of that of the links.  Row i, divided by D_ii, has a feature
for each cos(q_i - q_j) f_j and sin(q_i - q_j) v_j^2 with j other than i, sin q_i, cos q_i (a
direction that is not upright), each v_j (friction), each u_k, and 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edtorch.model.lift import Lift
from edtorch.model.terms import Factors, Terms
from edtorch.model.ties import Ties
from edtorch.model.told import Told

Sum = Sequence[tuple[float, int, Factors]]
"""(share, derivative, factors) of each term of a feature."""


def chain(told: Told, lift: Lift) -> tuple[Terms, Ties]:
    """The terms of all rows, and the features that they make up.

    Raises ValueError where a learned component is no rate of an angle.
    """
    angles = links(told)
    rates = [int(lift.at[i]) for i in told.learned]
    count = len(angles)
    plain = [*rates, *range(lift.action_at, lift.size)]
    found: list[tuple[int, Sum]] = []
    for i, own in enumerate(angles):
        for j, other in enumerate(angles):
            if j != i:
                found.append((i, cosine(lift, own, other, j)))
                found.append((i, _sine(lift, own, other, (rates[j], rates[j]))))
        gravity = (int(lift.at[own]), int(lift.at[own]) + 1)
        found += [(i, [(1.0, -1, factors)]) for factors in ((), *((k,) for k in gravity))]
        found += [(i, [(1.0, -1, (k,))]) for k in plain]
    return tied_terms(found, count)


def impact_terms(told: Told, lift: Lift) -> tuple[Terms, Ties]:
    """Of the rates before an impact (``edtorch.model.impact``): cos(q_i - q_j) v_j, and v_j.

    An impulse at a point of the chain changes row i by the velocity of that point times cos q_i and
    sin q_i, which are sums of the first kind.
    """
    angles = links(told)
    rates = [int(lift.at[i]) for i in told.learned]
    found: list[tuple[int, Sum]] = []
    for i, own in enumerate(angles):
        found += [(i, [(1.0, -1, (rate,))]) for rate in rates]
        found += [
            (i, cosine(lift, own, other, -1, (rate,)))
            for other, rate in zip(angles, rates, strict=True)
            if other != own
        ]
    return tied_terms(found, len(angles))


def links(told: Told) -> list[int]:
    """The angle whose rate each learned component is; ValueError where one is none."""
    for i in told.learned:
        of = told.rate_of[i]
        if of < 0 or not told.angle[of]:
            raise ValueError(
                f"model=chain: {told.names[i]!r} is learned and is no rate of an angle; expected"
                " angles and their rates alone (told.angles, told.rates, told.ignored)"
            )
    return [told.rate_of[i] for i in told.learned]


def cosine(lift: Lift, own: int, other: int, derivative: int, times: Factors = ()) -> Sum:
    """cos(q_own - q_other) times the entries ``times``, and f of ``derivative`` (-1: none)."""
    a, b = int(lift.at[own]), int(lift.at[other])
    return [
        (1.0, derivative, tuple(sorted((a + 1, b + 1, *times)))),
        (1.0, derivative, tuple(sorted((a, b, *times)))),
    ]


def _sine(lift: Lift, own: int, other: int, times: Factors) -> Sum:
    """sin(q_own - q_other) times the entries ``times``."""
    a, b = int(lift.at[own]), int(lift.at[other])
    return [
        (1.0, -1, tuple(sorted((a, b + 1, *times)))),
        (-1.0, -1, tuple(sorted((a + 1, b, *times)))),
    ]


def tied_terms(features: Sequence[tuple[int, Sum]], outputs: int) -> tuple[Terms, Ties]:
    """Terms and ties of features, each with the output that alone has it."""
    places: dict[tuple[int, Factors], int] = {}
    for _, parts in features:
        for _, derivative, factors in parts:
            places.setdefault((derivative, factors), len(places))
    # Features that several outputs have are one.
    rows = {tuple(parts): k for k, parts in enumerate({tuple(parts): 0 for _, parts in features})}
    share = np.zeros((len(rows), len(places)))
    allowed = np.zeros((outputs, len(rows)), dtype=np.bool_)
    for output, parts in features:
        row = rows[tuple(parts)]
        allowed[output, row] = True
        for part, derivative, factors in parts:
            share[row, places[derivative, factors]] = part
    return Terms.listed(list(places)), Ties(share, allowed)
