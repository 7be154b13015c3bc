"""Numbers as tables show them."""

from __future__ import annotations

import math

NONE = "-"
NEVER = "never"
"""For what is beyond every budget."""


def number(value: float | None, digits: int | None = None) -> str:
    """With so many digits after the point, or five significant ones, without needless zeros; what
    is tiny keeps two figures."""
    if value is None:
        return NONE
    if math.isinf(value):
        return NEVER
    if digits is None:
        digits = 0 if value == 0 else max(0, 4 - math.floor(math.log10(abs(value))))
    elif value and abs(value) < 10**-digits:
        return f"{value:.2g}"
    text = f"{value:,.{digits}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
