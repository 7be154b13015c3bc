"""Compile a function where the machine can, and log a message where it cannot."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable
from typing import Literal, TypeVar, cast

import torch

logger = logging.getLogger("edtorch")

CompileMode = Literal["auto", "on", "off"]

_Function = TypeVar("_Function", bound=Callable[..., object])


SUPPORTED = ((2, 13), (2, 14))
"""Tested versions of torch: from the first up to, but not including, the second."""


class CannotCompile(RuntimeError):
    """Compilation is unavailable; the message says why and gives a remedy."""


def check_compiler() -> None:
    """Raises CannotCompile without a compiler, a tested torch, or a path that torch can quote."""
    version = tuple(int(part) for part in torch.__version__.split(".")[:2])
    if not SUPPORTED[0] <= version < SUPPORTED[1]:
        least, bound = (".".join(map(str, v)) for v in SUPPORTED)
        raise CannotCompile(
            f"torch {torch.__version__} is outside of the range in which compiling has been tested,"
            f" {least} up to but not {bound}: install one of these"
        )
    named = os.environ.get("CXX")
    if not any(shutil.which(name) for name in ([named] if named else ["g++", "clang++"])):
        raise CannotCompile(
            f"no C++ compiler found ({named or 'g++ or clang++'}): install one, or name it in CXX"
        )
    # Last, so that the other messages are the same wherever the environment lies.
    if any(character.isspace() for character in torch.__file__):
        raise CannotCompile(
            f"torch lies under a path with a space, {torch.__file__!r}, which it does not quote for"
            " the compiler: move the environment"
        )


def compiled(function: _Function, *, mode: CompileMode) -> _Function:
    """``function`` compiled as one graph; with ``auto`` unchanged where compilation is unavailable.

    Raises CannotCompile with ``on``.
    """
    if mode == "off":
        return function
    try:
        check_compiler()
    except CannotCompile as error:
        if mode == "on":
            raise
        logger.warning("not compiled, some ten times slower: %s", error)
        return function
    # Loops of a graph (scan) run in C++ then, not in Python.
    options: dict[str, str | int | bool | Callable[..., object]] = {"cpp_wrapper": True}
    made = torch.compile(function, fullgraph=True, dynamic=False, options=options)
    return cast(_Function, made)
