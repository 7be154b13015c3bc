"""The planner's kernels as one compiled module, kept on disk like those of a learner."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from edtorch.native.program import ModuleSource, load_kernel

_FOLDER = Path(__file__).parent / "kernels"
_TEXTS = ("mechanism.py", "cost.py", "shooting.py", "quiet.py", "imagined.py")


def planner_source() -> ModuleSource:
    """The module of the kernels: nothing in it depends on the task."""
    texts = [(_FOLDER / name).read_text(encoding="utf-8") for name in _TEXTS]
    return ModuleSource("\n".join(("import math\nimport numpy as np", *texts)), "", {})


def _entries() -> dict[str, tuple[object, ...]]:
    """Arguments of the kinds that the kernels are given."""
    one, two, three, four = (np.zeros((1,) * size) for size in range(1, 5))
    index = np.zeros(1, np.int64)
    lift = (np.zeros(1, np.bool_), index, one, 1)
    model = (lift, (index, index, index, index), (index, index, one, 0.1, 1))
    cost, bounds = (three, one, one, 0.1), (one, one)
    settings = (0.1, 0.1, 0.1, 0.1, 0.1, 1, 0.1, 1, 0.1)
    problem = (model, two, cost, bounds)
    batch = (three, three, four, one, index)
    return {
        "tick_once": (one, two, model, one, two),
        "slope_once": (one, two, model, one, two),
        "expand_plan": (*problem, two, two, (three, three, two, three, two, two)),
        "backward": ((three, three, two, three, two, two), two, 0.1, two, three),
        "shoot": (*problem, settings, *batch),
        "connect": (*problem, settings, 0.1, *batch),
        "quieten": (*problem, (0.1, 1, 0.1), (two, two, three), three, two, two),
        "imagine": (model, three, cost, bounds, (two, two, three), two, three, three, one),
    }


@lru_cache(maxsize=1)
def kernels() -> Mapping[str, Callable[..., Any]]:
    """The kernels by name, compiled, or fetched from disk.

    Raises Unavailable, in one line, where numba is missing or has been set up otherwise.
    """
    entries = _entries()
    found = load_kernel(planner_source(), entries, "the planner")
    return MappingProxyType(dict(zip(entries, found, strict=True)))
