"""The kernels of models with strikes as one compiled module (``edtorch.search.program``).

A module of its own: who plans without strikes does not wait for these to be compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from edtorch.compiled import ModuleSource, load_kernel
from edtorch.search.tick_model import MODEL_KIND

_FOLDER = Path(__file__).parent / "kernels"
_TEXTS = ("names.py", "mechanism.py", "stops.py", "tick.py", "strikes.py")
_ONE, _TWO, _THREE, _FOUR = (np.zeros((1,) * dimensions) for dimensions in range(1, 5))
_INDEX, _PAIR = np.zeros(1, np.int64), np.zeros((1, 1), np.int64)
_STRIKE = (_ONE, _INDEX, _ONE, _PAIR, _INDEX, _TWO)


def _source(*more: str) -> ModuleSource:
    texts = [(_FOLDER / name).read_text(encoding="utf-8") for name in (*_TEXTS, *more)]
    return ModuleSource("\n".join(("import math\nimport numpy as np", *texts)), "", {})


@lru_cache(maxsize=1)
def striking_kernels() -> Mapping[str, Callable[..., Any]]:
    """The kernels by name, compiled, or fetched from disk; errors as ``program.kernels``."""
    entries: Mapping[str, tuple[object, ...]] = {
        "held_paths": (_TWO, _INDEX, _ONE, _TWO, MODEL_KIND, _THREE),
        "striking_rollouts": (_THREE, _FOUR, _THREE, MODEL_KIND, _STRIKE, _FOUR),
    }
    found = load_kernel(_source(), entries, "models with strikes")
    return MappingProxyType(dict(zip(entries, found, strict=True)))


@lru_cache
def run_kernel(policy: str, dimensions: tuple[int, ...]) -> Callable[..., Any]:
    """The kernel ``phase_runs`` of a kind of policy, whose ``arrays``
    (``edtorch.policy.vector``) have so many dimensions; errors as above."""
    form = tuple(np.zeros((1,) * own) for own in dimensions)
    ends = (_TWO, _TWO, _TWO, _INDEX, 0.1)
    given = (_TWO, _THREE, _THREE, _TWO, _THREE, MODEL_KIND, _STRIKE, (_ONE, _ONE), form, ends)
    entries = {"phase_runs": (*given, _PAIR, _PAIR)}
    (found,) = load_kernel(_source("phase_runs.py", f"{policy}.py"), entries, "runs of policies")
    return found
