"""Checks the shapes in annotations (``edtorch.shapes``) at every call while tests run.

Functions without such an annotation stay as they are; so does a function that torch is compiling.
A check depends on shapes and types alone, and takes longer than many of the functions: those of
a function that have passed it are not checked again.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import torch

_jaxtyped = jaxtyping.jaxtyped
_SOURCE = Path(__file__).parents[1] / "edtorch" / "shapes.py"  # to import it would come too early
_ALIASES = re.findall(r"^(\w+) = Float", _SOURCE.read_text(encoding="utf-8"), re.M)
_UNKNOWN = object()
_SHAPE = re.compile(rf"\b({'|'.join(['Float', *_ALIASES])})\b")


def _shapes(function: Any) -> dict[str, Any]:
    """The annotations that say shapes; protocols among the others cannot be checked."""
    hints = {} if isinstance(function, type) else getattr(function, "__annotations__", {})
    return {key: hint for key, hint in hints.items() if _SHAPE.search(str(hint))}


def _forms(values: Iterable[Any]) -> Iterator[Any]:
    """What a check of values depends on; ``_UNKNOWN`` for what holds tensors of its own."""
    for value in values:
        if isinstance(value, torch.Tensor):
            yield value.shape, value.dtype
        elif isinstance(value, tuple):
            yield len(value)
            yield from _forms(value)
        else:
            yield type(value) if value is None or isinstance(value, int | float) else _UNKNOWN


def checked(*, typechecker: Any) -> Callable[[Any], Any]:
    """In place of ``jaxtyping.jaxtyped``, which its import hook puts on every function."""

    def decorate(function: Any) -> Any:
        shapes = _shapes(function)
        if not shapes:
            return function
        result: list[Any] = []

        @functools.wraps(function)
        def returning(*args: Any, **kwargs: Any) -> Any:
            return result.pop()

        hints = function.__annotations__
        function.__annotations__ = returning.__annotations__ = shapes
        whole, fits = (_jaxtyped(typechecker(f), typechecker=None) for f in (function, returning))
        function.__annotations__ = hints
        code = function.__code__
        places = [
            k for k, name in enumerate(code.co_varnames[: code.co_argcount]) if name in shapes
        ]
        passed: set[tuple[Any, ...]] = set()

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            if torch.compiler.is_compiling():
                return function(*args, **kwargs)
            named = [name for name in kwargs if name in shapes]
            positional = _forms(args[k] for k in places if k < len(args))
            given = (*positional, *named, *_forms(kwargs[name] for name in named))
            known = given in passed
            value = (function if known else whole)(*args, **kwargs)
            forms = (*given, "return", *_forms((value,))) if "return" in shapes else given
            if known and forms not in passed:
                result.append(value)
                fits(*args, **kwargs)
            if _UNKNOWN not in forms:
                passed.update((given, forms))
            return value

        return call

    return decorate


def install() -> None:
    """Check what is imported from now on."""
    jaxtyping.jaxtyped = checked
    jaxtyping.install_import_hook("edtorch", "beartype.beartype")
