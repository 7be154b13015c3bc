"""Sine, cosine, arctangent and arcsine of numbers, without branches or calls: a loop over lanes
becomes vector code, and the digits are the same on every processor.

The approximations are those of S. L. Moshier's Cephes library, to about 1e-16 relative.
``sims.compiled_rows`` has them compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Function = Callable[..., Any]

# pi / 2 in three parts, of which two have 26 bits: their products with whole numbers below 2^27 are
# exact.  Beyond arguments of 2e8 the error is about that of the argument's own last digit; beyond
# 1e15, where that is an eighth of a radian, an argument counts as zero.
_P1, _P2, _P3 = 1.5707963109016418, 1.5893254712295857e-08, 6.123233995736766e-17
_LATTER_HALF = 6.123233995736766e-17
"""Of pi / 2, what its last digit leaves out."""


def functions(jit: Function) -> dict[str, Function]:
    """``sin``, ``cos``, ``atan`` and ``asin`` by name, made by ``jit``, as of ``sims.rows``."""

    @jit
    def turned(x: float, quarters: float) -> float:
        """sin(x + quarters pi / 2)."""
        x = x if abs(x) < 1e15 else 0.0 * x
        n = np.rint(x * (2 / math.pi))
        r = ((x - n * _P1) - n * _P2) - n * _P3
        n = n + quarters
        z = r * r
        sine = 1.58962301576546568060e-10
        sine = sine * z - 2.50507477628578072866e-8
        sine = sine * z + 2.75573136213857245213e-6
        sine = sine * z - 1.98412698295895385996e-4
        sine = sine * z + 8.33333333332211858878e-3
        sine = sine * z - 1.66666666666666307295e-1
        sine = r + r * z * sine
        cosine = -1.13585365213876817300e-11
        cosine = cosine * z + 2.08757008419747316778e-9
        cosine = cosine * z - 2.75573141792967388112e-7
        cosine = cosine * z + 2.48015872888517045348e-5
        cosine = cosine * z - 1.38888888888730564116e-3
        cosine = cosine * z + 4.16666666666665929218e-2
        cosine = 1.0 - 0.5 * z + z * z * cosine
        halves = np.floor(n * 0.5)
        found = cosine if n - 2 * halves > 0.5 else sine
        return -found if halves - 2 * np.floor(halves * 0.5) > 0.5 else found

    @jit
    def sin(x: float) -> float:
        return turned(x, 0.0)

    @jit
    def cos(x: float) -> float:
        return turned(x, 1.0)

    @jit
    def atan(x: float) -> float:
        size = abs(x)
        far, near = size > 2.41421356237309504880, size <= 0.66
        above = -1.0 if far else (size if near else size - 1.0)
        below = size if far else (1.0 if near else size + 1.0)
        r = above / below
        z = r * r
        p = -8.750608600031904122785e-1
        p = p * z - 1.615753718733365076637e1
        p = p * z - 7.500855792314704667340e1
        p = p * z - 1.228866684490136173410e2
        p = p * z - 6.485021904942025371773e1
        q = z + 2.485846490142306297962e1
        q = q * z + 1.650270098316988542046e2
        q = q * z + 4.328810604912902668951e2
        q = q * z + 4.853903996359136964868e2
        q = q * z + 1.945506571482613964425e2
        quarters = 1.0 if far else (0.0 if near else 0.5)
        found = quarters * (math.pi / 2) + (r * (z * p / q) + r + quarters * _LATTER_HALF)
        return -found if x < 0 else found

    @jit
    def asin(x: float) -> float:
        return atan(x / np.sqrt((1.0 - x) * (1.0 + x)))

    return {"sin": sin, "cos": cos, "atan": atan, "asin": asin}
