"""Units by name: the factor from one to another."""

from __future__ import annotations

import math
import re

_DEGREE, _TURN = math.pi / 180, 2 * math.pi
_SI = {"rad", "m", "s", "g", "N", "V", "A", "K"}
_PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}
_NAMED = {
    **{name: ("rad", _DEGREE) for name in ("deg", "degree", "degrees", "°")},
    **{name: ("rad", _TURN) for name in ("rev", "turn")},
    **{"min": ("s", 60.0), "h": ("s", 3600.0), "1": ("", 1.0), "%": ("", 0.01)},
}
_COMPOUNDS = {"": "1", "rpm": "rev/min", "Nm": "N m", "mNm": "mN m", "Hz": "1/s"}
_POWER = {"²": 2, "³": 3}


def _base(name: str) -> tuple[str, float] | None:
    """The unit that a name without powers is a multiple of, and the factor; None: unknown."""
    if name in _SI:
        return name, 1.0
    if name in _NAMED:
        return _NAMED[name]
    if name[1:] in _SI and name[:1] in _PREFIXES:
        return name[1:], _PREFIXES[name[0]]
    return None


def _parsed(unit: str) -> tuple[dict[str, int], float]:
    """The exponents of the base units, and the factor to them.  Raises ValueError."""
    exponents: dict[str, int] = {}
    factor = 1.0
    for place, term in enumerate(_COMPOUNDS.get(unit, unit).split("/")):
        for part in re.split(r"[ *·]+", term.strip()):
            match = re.fullmatch(r"(1|.+?)(?:\^?(-?[1-9])|([²³]))?", part)
            found = None if match is None else _base(match[1])
            if match is None or found is None:
                known = ", ".join([*sorted(_SI), *_NAMED, *list(_COMPOUNDS)[1:]])
                raise ValueError(
                    f"unknown unit {unit!r}; known are {known}, with the prefixes"
                    f" {', '.join(_PREFIXES)}, and products, quotients and powers of them"
                )
            power = int(match[2] or _POWER.get(match[3], 1)) * (-1 if place else 1)
            base, scale = found
            factor *= scale**power
            exponents[base] = exponents.get(base, 0) + power
    return {base: power for base, power in exponents.items() if base and power}, factor


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
