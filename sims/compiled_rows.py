"""The rows of a simulator (``sims.rows``) compiled to scalar code by numba.

numba takes seconds to import: only code that compiles imports this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import FunctionType, ModuleType
from typing import Any, cast

import numba
import numpy as np
from torch import Tensor

from sims import elementary
from sims.rows import HasRows, Namespace, Rows, rows_of


def _sign(x: float) -> float:
    # 0 for NaN, as torch has it.
    return (1.0 if x > 0 else 0.0) - (1.0 if x < 0 else 0.0)


def _minimum(a: float, b: float) -> float:
    return a if a < b or a != a else b


def _maximum(a: float, b: float) -> float:
    return a if a > b or a != a else b


def _where(mask: bool, a: Any, b: Any) -> Any:
    return a if mask else b


def _both(a: bool, b: bool) -> bool:
    return a & b


def _either(a: bool, b: bool) -> bool:
    return a | b


def _negated(mask: bool) -> bool:
    return not mask


def _as_number(mask: bool) -> float:
    return 1.0 if mask else 0.0


def _tiny(x: float) -> float:
    return 2.2250738585072014e-308


def numba_namespace(key: str) -> Namespace:
    """The functions for compiled code, ``key`` being part of the name of each that ``jit`` makes.

    numba knows a compiled function by name, types and a count within its process; code from a cache
    on disk calls functions by these names.  A key that tells apart what is compiled keeps functions
    of different processes from being taken for one another.
    """

    def jit(function: Any) -> Any:
        if not isinstance(function, FunctionType):
            return function
        # A copy, for a function of a module may be compiled under several keys.
        own = FunctionType(
            function.__code__,
            function.__globals__,
            f"{function.__name__}_{key}",
            function.__defaults__,
            function.__closure__,
        )
        own.__qualname__ = f"{function.__qualname__}_{key}"
        own.__module__, own.__kwdefaults__ = function.__module__, function.__kwdefaults__
        return numba.njit(error_model="numpy", nogil=True, forceinline=True)(own)

    # A module: numba looks up its attributes when it compiles, those of other objects it does not.
    namespace = ModuleType(f"numba_namespace_{key}")
    vars(namespace).update(
        **elementary.functions(jit),
        tan=math.tan,
        tanh=math.tanh,
        sqrt=math.sqrt,
        exp=math.exp,
        log=math.log,
        log1p=math.log1p,
        floor=np.floor,
        round=np.rint,
        abs=abs,
        isfinite=math.isfinite,
        sign=jit(_sign),
        minimum=jit(_minimum),
        maximum=jit(_maximum),
        where=jit(_where),
        both=jit(_both),
        either=jit(_either),
        negated=jit(_negated),
        as_number=jit(_as_number),
        tiny=jit(_tiny),
        jit=jit,
    )
    return cast(Namespace, namespace)


def compiled(sim: HasRows, key: str) -> Rows:
    """The rows of ``sim``, its functions compiled by numba when they are first called.

    Raises NoRows and ValueError as ``sims.rows.rows_of``.
    """
    rows_of(sim)
    xp = numba_namespace(key)
    rows = sim.rows(xp)
    # All of one type: whole numbers would be compiled apart.
    constants: Any = [float(value) for value in rows.constants]
    constants = getattr(type(rows.constants), "_make", tuple)(constants)
    functions: dict[str, Callable[..., Any]] = {
        name: xp.jit(getattr(rows, name))
        for name in ("step", "observe", "outcome", "start", "birth", "stepped")
        if getattr(rows, name) is not None
    }
    return replace(rows, constants=constants, **functions)


def first_difference(
    rows: Rows, member: str, arguments: Sequence[Tensor], wanted: Tensor, tolerance: float = 1e-12
) -> str | None:
    """Where the compiled function ``member`` of ``rows`` differs from ``wanted`` ``[b, n]``, or
    ``[b]`` for one row, by more than ``tolerance`` of 1 + |x|; None if it does not.

    arguments: tensors ``[b, ...]``.  ValueError, one line, where it cannot be compiled.
    """
    function = getattr(rows, member)
    for k in range(len(wanted)):
        try:
            got = function(*(tuple(x[k].tolist()) for x in arguments), rows.constants)
        except Exception as error:
            # Of numba's own kinds, and assertions of its passes.
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            reason = " ".join(lines[1:4]) or f"{type(error).__name__} {error}".strip()
            raise ValueError(
                f"{member} cannot be compiled: {reason} (a function that another one"
                " calls needs @xp.jit)"
            ) from error
        found, right = np.array(got, dtype=float), wanted[k].double().numpy()
        if found.shape != right.shape:
            return f"{member} has shape {found.shape} compiled, {right.shape} in torch"
        close = np.abs(found - right) <= tolerance * (1 + np.abs(right))
        same = close | (found == right) | (np.isnan(found) & np.isnan(right))
        if not same.all():
            place = int(np.argmin(same))
            values = f"{found.flat[place]!r} compiled, {right.flat[place]!r} in torch"
            return f"{member}: component {place} is {values}"
    return None
