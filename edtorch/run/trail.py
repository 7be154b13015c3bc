"""The recent past of every world, for pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor


class Trail:
    """Recent states of ``size`` worlds, each ``stride`` ticks: a ring of ``capacity`` rows."""

    def __init__(self, world: Tensor, stride: int, capacity: int) -> None:
        self.stride = stride
        self.capacity = capacity
        self.size = world.shape[0]
        self._ring = torch.zeros(capacity, *world.shape, dtype=world.dtype, device=world.device)
        self._count = torch.zeros(world.shape[0], dtype=torch.int64, device=world.device)

    def extend(self, world: Tensor, active: Tensor) -> None:
        """Add states ``[T, size, k]`` of the learners, where they were active ``[T, size]``."""
        for part, own in zip(world.split(self.capacity), active.split(self.capacity), strict=True):
            point, row = own.nonzero(as_tuple=True)
            place = (self._count + own.cumsum(0) - 1)[point, row] % self.capacity
            self._ring[place, row] = part[point, row]
            self._count += own.sum(0)

    def position(self, row: int) -> int:
        """How many states of this learner have been added."""
        return int(self._count[row])

    def states(self, row: int, first: int, last: int) -> Tensor:
        """States first..last-1 of a learner, ``[T, k]``; as many of the last as are still there."""
        first = max(first, self.position(row) - self.capacity)
        index = torch.arange(first, max(first, last)) % self.capacity
        return self._ring[index.to(self._ring.device), row].cpu()

    def state(self) -> dict[str, Any]:
        """What has been added and is still there."""
        filled = min(int(self._count.max()), self.capacity)
        return {"ring": self._ring[:filled], "count": self._count}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what another one of the same sizes has; ValueError for one of other sizes."""
        ring = state["ring"]
        if ring.shape[1:] != self._ring.shape[1:] or len(ring) > self.capacity:
            raise ValueError(
                f"trail: has the shape {list(ring.shape)}, expected {list(self._ring.shape)} or"
                " less of the first"
            )
        self._ring[: len(ring)] = ring
        self._count.copy_(state["count"])
