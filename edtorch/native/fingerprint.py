"""What a compiled function depends on, as text: its code and all that it closes over."""

from __future__ import annotations

import types
from collections.abc import Iterator
from enum import Enum
from typing import Any

from edtorch.errors import Unavailable
from sims.rows import TORCH

_KNOWN = ("torch", "numba", "numpy", "math")
"""Packages whose functions are what their names say."""


def fingerprint(part: object) -> str:
    """A text that is equal for two functions only if they compute the same: code, constants, and
    whatever they close over.  Raises Unavailable for what cannot be described."""
    return "\n".join(_described(part, set()))


def _described(part: Any, seen: set[int]) -> Iterator[str]:
    yield type(part).__qualname__
    if isinstance(part, types.ModuleType) and part.__name__.partition(".")[0] not in _KNOWN:
        raise Unavailable(
            f"module {part.__name__}: expected its functions and numbers themselves in what a"
            " simulator's rows close over (from ... import ...)"
        )
    if isinstance(part, type) and issubclass(part, Enum):
        yield from _described([(member.name, member.value) for member in part], seen)
    if part is TORCH or isinstance(part, types.BuiltinFunctionType | types.ModuleType | type):
        yield getattr(part, "__module__", "") or getattr(part, "__name__", "")
        yield getattr(part, "__qualname__", "")
    elif isinstance(part, types.FunctionType):
        yield f"{part.__module__}.{part.__qualname__}"
        if id(part) not in seen and part.__module__.partition(".")[0] not in _KNOWN:
            seen.add(id(part))
            cells = [cell.cell_contents for cell in part.__closure__ or ()]
            names = [name for name in _names(part.__code__) if name in part.__globals__]
            called = [(name, part.__globals__[name]) for name in names]
            defaults = (part.__defaults__, sorted((part.__kwdefaults__ or {}).items()))
            yield from _described([part.__code__, defaults, cells, called], seen)
    elif isinstance(part, types.CodeType):
        yield f"{part.co_code.hex()} {part.co_names}"
        yield from _described(part.co_consts, seen)
    elif isinstance(part, tuple | list):
        for each in part:
            yield from _described(each, seen)
    elif part is None or isinstance(part, bool | int | float | complex | str | bytes):
        yield repr(part)
    elif hasattr(part, "__dataclass_fields__"):
        yield from _described([getattr(part, name) for name in part.__dataclass_fields__], seen)
    else:
        raise Unavailable(
            f"{type(part).__name__}: expected functions, numbers, texts and tuples in what a"
            " simulator's rows close over"
        )


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)
