"""Notices components of an observation that are the cosine and the sine of one angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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

    def add(self, observation: NDArray[np.floating]) -> str | None:
        """The line about the pairs, with the observation by which it is decided; else None."""
        self._left -= 1
        if self._left < 0:
            return None
        square = observation.astype(float) ** 2
        self._fits &= np.abs(square[:, None] + square - 1) < _ERROR
        self._low = np.minimum(self._low, observation)
        self._high = np.maximum(self._high, observation)
        if self._left:
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
