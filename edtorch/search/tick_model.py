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
        """The argument ``model`` of the kernels (``kernels/names.py``)."""
        structure, lift = self.structure, self.structure.lift
        stops = self.stops or Stops.none(len(structure.source))
        tree, node = product_tree(structure.terms.factors)
        term, output = np.argwhere(structure.allowed.numpy().T).T
        pair = (term, output, node[term], structure.terms.derivative[term])
        stop = (stops.level, stops.turn, stops.column)
        return (
            whole(np.stack((lift.angle, lift.at, structure.source), -1), np.int64),
            real(np.stack((lift.unit, structure.ratio), -1)),
            whole(structure.learned, np.int64),
            whole(tree, np.int64),
            whole(np.stack(pair, -1), np.int64),
            real(np.concatenate((np.stack(stop, -1), stops.normal), -1)),
            lift.action_at,
            lift.actions,
            float(self.dt),
            self.substeps,
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


def product_tree(factors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Products of entries of the lift as a tree, parents first.

    factors ``[K, D]``: of each term, padded by 0.  Returns parent and factor ``[P, 2]`` (product p
    is its parent times entry factor, product 0 is 1), and the product ``[K]`` of each term.
    """
    place: dict[tuple[int, ...], int] = {(): 0}
    tree, node = [(0, 0)], []
    for row in factors:
        entries = tuple(sorted(int(entry) for entry in row if entry))
        for size in range(1, len(entries) + 1):
            if entries[:size] not in place:
                place[entries[:size]] = len(tree)
                tree.append((place[entries[: size - 1]], entries[size - 1]))
        node.append(place[entries])
    return np.array(tree), np.array(node, np.int64)


MODEL_KIND = (
    *(np.zeros((1, 1), np.int64), np.zeros((1, 1)), np.zeros(1, np.int64)),
    *(np.zeros((1, 1), np.int64), np.zeros((1, 1), np.int64), np.zeros((1, 1))),
    *(1, 1, 0.1, 1, 1, 0.1),
)
"""What has the types of ``TickModel.parts``."""
