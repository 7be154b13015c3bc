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
_TEXTS = (
    "names.py",
    "mechanism.py",
    "stops.py",
    "tick.py",
    "strikes.py",
    "phase_runs.py",
)
_TWO = np.zeros((1, 1))
_FORMS: Mapping[str, tuple[np.ndarray, ...]] = {"phase": (_TWO,) * 7, "linear": (np.zeros(1),)}
"""Of each policy's kernel (``edtorch.policy.vector``), what it is given beside the vector."""


def _entries(policy: str) -> dict[str, tuple[object, ...]]:
    """Arguments of the kinds that the kernels are given."""
    one, two, three = np.zeros(1), _TWO, np.zeros((1, 1, 1))
    four = np.zeros((1, 1, 1, 1))
    index, pair, model = np.zeros(1, np.int64), np.zeros((1, 1), np.int64), MODEL_KIND
    strike = (one, index, one, pair, index, two)
    form, ends = _FORMS[policy], (two, two, two, index, 0.1)
    return {
        "phase_runs": (
            *(two, three, three, two, three, model, strike, (one, one), form, ends, pair, pair),
        ),
        "held_paths": (two, index, one, two, model, three),
        "striking_rollouts": (three, four, three, model, strike, four),
    }


@lru_cache(maxsize=len(_FORMS))
def striking_kernels(policy: str = "phase") -> Mapping[str, Callable[..., Any]]:
    """The kernels by name, compiled, or fetched from disk, with runs of this kind of ``policy``;
    errors as ``program.kernels``."""
    names = (*_TEXTS, f"{policy}.py")
    texts = [(_FOLDER / name).read_text(encoding="utf-8") for name in names]
    source = ModuleSource("\n".join(("import math\nimport numpy as np", *texts)), "", {})
    entries = _entries(policy)
    found = load_kernel(source, entries, "models with strikes")
    return MappingProxyType(dict(zip(entries, found, strict=True)))
