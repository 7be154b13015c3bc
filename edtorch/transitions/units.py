"""Units by name: the factor from one to another."""

from __future__ import annotations

import math
import re

_BASES: dict[str, tuple[str, float]] = {
    "": ("", 1.0),
    "1": ("", 1.0),
    "%": ("", 0.01),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.pi / 180),
    "degree": ("rad", math.pi / 180),
    "degrees": ("rad", math.pi / 180),
    "°": ("rad", math.pi / 180),
    "rev": ("rad", 2 * math.pi),
    "turn": ("rad", 2 * math.pi),
    "m": ("m", 1.0),
    "um": ("m", 1e-6),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "km": ("m", 1e3),
    "s": ("s", 1.0),
    "ns": ("s", 1e-9),
    "us": ("s", 1e-6),
    "µs": ("s", 1e-6),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
    "g": ("kg", 1e-3),
    "kg": ("kg", 1.0),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "kN": ("N", 1e3),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
    "K": ("K", 1.0),
}
_COMPOUNDS = {"rpm": "rev/min", "Nm": "N m", "mNm": "mN m", "Hz": "1/s"}


def _parsed(unit: str) -> tuple[dict[str, int], float]:
    """The exponents of the base units, and the factor to them."""
    exponents: dict[str, int] = {}
    factor = 1.0
    numerator, *denominators = _COMPOUNDS.get(unit, unit).split("/")
    for sign, term in ((1, numerator), *((-1, each) for each in denominators)):
        for part in re.split(r"[ *·]+", term.strip()):
            match = re.fullmatch(r"(.*?)(?:\^?(-?[1-9])|([²³]))?", part)
            name, digit, raised = match.groups() if match and part != "1" else (part, None, None)
            if name not in _BASES:
                raise ValueError(
                    f"unknown unit {unit!r}; known are {', '.join(list(_BASES)[1:])}"
                    f", {', '.join(_COMPOUNDS)}, and products, quotients and powers"
                )
            power = sign * int(digit or {"²": 2, "³": 3}.get(raised or "", 1))
            base, scale = _BASES[name]
            factor *= scale**power
            if base:
                exponents[base] = exponents.get(base, 0) + power
    return {base: power for base, power in exponents.items() if power}, factor


def conversion(source: str, target: str) -> float:
    """What a value in ``source`` is multiplied by to be in ``target``: "deg/s", "rad/s".

    Equal names need not be known.  Raises ValueError for unknown units and other dimensions.
    """
    if source == target:
        return 1.0
    (one, factor), (other, divisor) = _parsed(source), _parsed(target)
    if one != other:
        raise ValueError(f"cannot convert {source!r} to {target!r}")
    return factor / divisor
