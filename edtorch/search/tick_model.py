"""A learned mechanism model over a tick, as the planner's kernels take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops

MOST_HITS = 8
"""Of stops in a tick."""


@dataclass(frozen=True, eq=False)
class TickModel:
    """A mechanism model with its weights and the bounds of its actions.

    weight ``[L, K]``; dt: seconds of a tick, which takes ``substeps`` steps of Runge and Kutta's
    method; middle and half ``[m]``: the bounds of the actions, scaled, are middle - half and
    middle + half.  stops: None for a smooth model.  saltation: whether Jacobians say how the
    time of a hit moves.
    """

    structure: Structure
    weight: np.ndarray
    dt: float
    middle: np.ndarray
    half: np.ndarray
    substeps: int = 2
    stops: Stops | None = None
    saltation: bool = True

    @property
    def parts(self) -> tuple[Any, ...]:
        """Tuples of arrays: of the lift, of the terms, of the motion, of the stops."""
        lift, terms = self.structure.lift, self.structure.terms
        return (
            (whole(lift.angle, bool), whole(lift.at, np.int64), real(lift.unit), lift.action_at),
            (
                *product_tree(terms.factors),
                whole(terms.derivative, np.int64),
                whole(np.argwhere(self.structure.allowed.numpy().T), np.int64),
            ),
            (
                whole(self.structure.learned, np.int64),
                whole(self.structure.source, np.int64),
                real(self.structure.ratio),
                float(self.dt),
                self.substeps,
            ),
            self._stops,
        )

    @property
    def _stops(self) -> tuple[Any, ...]:
        stops, n = self.stops, len(self.structure.source)
        if stops is None:
            stops = Stops.none(n)
        return (
            real(stops.normal),
            real(stops.level),
            real(stops.turn),
            whole(stops.column, np.int64),
            real(stops.by_learned(self.structure)),
            MOST_HITS,
            float(self.saltation),
        )

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """middle and half."""
        return real(self.middle), real(self.half)


def whole(values: Any, kind: type) -> np.ndarray:
    """As kernels take it: of this kind, contiguous and writable."""
    return np.require(values, kind, ["C", "W"])


def real(values: Any) -> np.ndarray:
    """The same in float64."""
    return whole(values, np.float64)


def product_tree(factors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of entries of the lift as a tree, parents first.

    factors ``[K, D]``: of each term, padded by 0.  Returns parent and factor ``[P]`` (product p is
    product parent[p] times entry factor[p], product 0 is 1), and node ``[K]``: of each term.
    """
    place: dict[tuple[int, ...], int] = {(): 0}
    parent, factor, node = [0], [0], []
    for row in factors:
        entries = tuple(sorted(int(entry) for entry in row if entry))
        for size in range(1, len(entries) + 1):
            if entries[:size] not in place:
                place[entries[:size]] = len(parent)
                parent.append(place[entries[: size - 1]])
                factor.append(entries[size - 1])
        node.append(place[entries])
    return np.array(parent), np.array(factor), np.array(node, np.int64)
