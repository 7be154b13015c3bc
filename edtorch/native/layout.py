"""Where a population lies in the memory of kernels.

A population, or its learners alone, is a tree of tensors ``[B, ...]``.  Kernels take groups of
``lanes`` learners: numbers as ``[G, R, lanes]`` float64 and counters as ``[G, C, lanes]`` int64,
each leaf of the tree being some rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.utils import _pytree as pytree

from edtorch.run.trees import tensors_of

_FIRST = ("learners.model.", "learners.fit.", "learners.noise.")
"""What a fit changes lies together, in this order: it is kept or dropped as a whole."""


@dataclass(frozen=True)
class Leaf:
    """shape: of one learner's part; row: the first one; counts: whether it is a counter."""

    shape: tuple[int, ...]
    dtype: torch.dtype
    row: int
    counts: bool

    @property
    def rows(self) -> slice:
        """All of them."""
        return slice(self.row, self.row + int(np.prod(self.shape, dtype=int)))


@dataclass(frozen=True)
class RowLayout:
    """leaves: by dotted name, in the order of the tree; numbers, counters: how many rows."""

    leaves: dict[str, Leaf]
    spec: pytree.TreeSpec
    numbers: int
    counters: int

    @staticmethod
    def of(tree: Any) -> RowLayout:
        """For a tree like this one."""
        tensors = tensors_of(tree)
        rows = {True: 0, False: 0}
        leaves: dict[str, Leaf] = {}
        for name in sorted(tensors, key=_place):
            tensor = tensors[name]
            counts = not tensor.dtype.is_floating_point
            leaf = Leaf(tuple(tensor.shape[1:]), tensor.dtype, rows[counts], counts)
            rows[counts] = leaf.rows.stop
            leaves[name] = leaf
        ordered = {name: leaves[name] for name in tensors}
        return RowLayout(ordered, pytree.tree_structure(tree), rows[False], rows[True])

    def pack(self, tree: Any, lanes: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
        """Numbers and counters; the last group is filled up with the last learner, not active."""
        size = len(pytree.tree_leaves(tree)[0])
        groups = -(-size // lanes)
        index = np.minimum(np.arange(groups * lanes), size - 1)
        numbers = np.empty((groups, self.numbers, lanes))
        counters = np.empty((groups, self.counters, lanes), dtype=np.int64)
        for tensor, leaf in zip(pytree.tree_leaves(tree), self.leaves.values(), strict=True):
            flat = tensor.detach().cpu().reshape(size, -1).numpy()[index]
            into = counters if leaf.counts else numbers
            into[:, leaf.rows] = flat.reshape(groups, lanes, -1).transpose(0, 2, 1)
        active = self.leaves.get("worlds.active")
        if active is not None:
            counters[-1, active.row, size - (groups - 1) * lanes :] = 0
        return numbers, counters

    def unpack(
        self, numbers: np.ndarray[Any, Any], counters: np.ndarray[Any, Any], size: int
    ) -> Any:
        """The tree of the first ``size`` learners."""
        found = []
        for leaf in self.leaves.values():
            rows = (counters if leaf.counts else numbers)[:, leaf.rows]
            flat = rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])[:size]
            found.append(torch.from_numpy(flat.copy()).to(leaf.dtype).reshape(size, *leaf.shape))
        return pytree.tree_unflatten(found, self.spec)


def _place(name: str) -> int:
    starts = [place for place, start in enumerate(_FIRST) if name.startswith(start)]
    return starts[0] if starts else len(_FIRST)
