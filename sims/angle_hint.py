"""Notices components of an observation that are the cosine and the sine of one angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_ENOUGH = 200
"""Observations after which it is decided."""
_ERROR, _RANGE = 1e-5, 0.05
"""Greatest error of c^2 + s^2 = 1, and the least range of both, for which a pair counts."""


class AngleHint:
    """Pairs i < j of components ``[n]`` with o_i^2 + o_j^2 = 1 in all observations so far, both of
    which have moved."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._left = _ENOUGH
        self._fits = np.triu(np.ones((len(names), len(names)), dtype=bool), 1)
        self._low = np.full(len(names), np.inf)
        self._high = -self._low

    def memory(self) -> dict[str, Tensor]:
        """What it has found, to go on from in another one."""
        return {
            "left": torch.tensor(self._left),
            "fits": torch.from_numpy(self._fits.copy()),
            "low": torch.from_numpy(self._low.copy()),
            "high": torch.from_numpy(self._high.copy()),
        }

    def recall(self, memory: dict[str, Tensor]) -> None:
        """Go on from there."""
        self._left = int(memory["left"])
        self._fits = memory["fits"].numpy().copy()
        self._low, self._high = (memory[name].numpy().copy() for name in ("low", "high"))

    def add(self, observation: NDArray[np.floating]) -> str | None:
        """The line about the pairs, with the observation by which it is decided; else None."""
        self._left -= 1
        if self._left < 0:
            return None
        square = observation.astype(float) ** 2
        self._fits &= np.abs(square[:, None] + square - 1) < _ERROR
        self._low = np.minimum(self._low, observation)
        self._high = np.maximum(self._high, observation)
        return None if self._left else self.line

    @property
    def line(self) -> str | None:
        """The line about the pairs, None if there is none, or as long as that is not decided."""
        if self._left > 0:
            return None
        moved = self._high - self._low > _RANGE
        places = np.argwhere(self._fits & moved & moved[:, None]).tolist()
        pairs = [f"({self._names[i]}, {self._names[j]})" for i, j in places]
        if not pairs:
            return None
        return (
            f"{', '.join(pairs)} look like cosine and sine of an angle, or sine and cosine;"
            " angles={'NAME': ('COSINE', 'SINE')} makes one component of them"
        )
