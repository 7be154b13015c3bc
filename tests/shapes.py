"""Checks the shapes in annotations (``edtorch.shapes``) at every call while tests run.

Functions without such an annotation stay as they are; so does a function that torch is compiling.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jaxtyping
import torch

_jaxtyped = jaxtyping.jaxtyped
_SOURCE = Path(__file__).parents[1] / "edtorch" / "shapes.py"  # to import it would come too early
_ALIASES = re.findall(r"^(\w+) = Float", _SOURCE.read_text(encoding="utf-8"), re.M)
_SHAPE = re.compile(rf"\b({'|'.join(['Float', *_ALIASES])})\b")


def _shapes(function: Any) -> dict[str, Any]:
    """The annotations that say shapes; protocols among the others cannot be checked."""
    hints = {} if isinstance(function, type) else getattr(function, "__annotations__", {})
    return {key: hint for key, hint in hints.items() if _SHAPE.search(str(hint))}


def _checked(*, typechecker: Any) -> Callable[[Any], Any]:
    """In place of ``jaxtyping.jaxtyped``, which its import hook puts on every function."""

    def decorate(function: Any) -> Any:
        shapes = _shapes(function)
        if not shapes:
            return function
        hints = function.__annotations__
        function.__annotations__ = shapes
        checked = _jaxtyped(typechecker(function), typechecker=None)
        function.__annotations__ = hints

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            chosen = function if torch.compiler.is_compiling() else checked
            return chosen(*args, **kwargs)

        return call

    return decorate


def install() -> None:
    """Check what is imported from now on."""
    jaxtyping.jaxtyped = _checked
    jaxtyping.install_import_hook("edtorch", "beartype.beartype")
