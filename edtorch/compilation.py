"""Compiling a function where the machine can, and saying so where it cannot."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable
from typing import Literal, TypeVar, cast

import torch

logger = logging.getLogger("edtorch")

Wish = Literal["auto", "on", "off"]

_Function = TypeVar("_Function", bound=Callable[..., object])


def compiler() -> str | None:
    """The C++ compiler that torch.compile would call, None if there is none."""
    for name in (os.environ.get("CXX"), "g++", "clang++", "c++"):
        if name and shutil.which(name):
            return name
    return None


def compiled(function: _Function, *, wish: Wish) -> _Function:
    """``function`` compiled as one graph; with ``auto`` as it is where there is no compiler."""
    if wish == "off":
        return function
    if compiler() is None:
        if wish == "on":
            raise ValueError("compile=on: expected a C++ compiler (g++ or clang++) on the PATH")
        logger.warning("no C++ compiler on the PATH: not compiled, some ten times slower")
        return function
    # Loops of a graph (scan) run in C++ then, not in Python.
    options: dict[str, str | int | bool | Callable[..., object]] = {"cpp_wrapper": True}
    made = torch.compile(function, fullgraph=True, dynamic=False, options=options)
    return cast(_Function, made)
