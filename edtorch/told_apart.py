"""Numbers in messages, with as many digits as tell them apart."""

from __future__ import annotations

_DIGITS = (6, 9, 12, 15)


def told_apart(*numbers: float) -> list[str]:
    """Each number as text, with the fewest digits at which different numbers look different.

    >>> told_apart(0.4, 0.5), told_apart(0.4, 0.4 + 1e-8)
    (['0.4', '0.5'], ['0.4', '0.40000001'])
    """
    for digits in _DIGITS:
        texts = [f"{number:.{digits}g}" for number in numbers]
        if len(set(texts)) == len(set(numbers)):
            return texts
    return [repr(float(number)) for number in numbers]
