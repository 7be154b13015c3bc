"""The planner's kernels as one compiled module, kept on disk like those of a learner."""

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
    *("names.py", "mechanism.py", "stops.py", "tick.py", "cost.py", "shooting.py"),
    *("noise_aware.py", "imagined.py", "lifted_policy.py"),
)


def planner_source() -> ModuleSource:
    """The module of the kernels: nothing in it depends on the task."""
    texts = [(_FOLDER / name).read_text(encoding="utf-8") for name in _TEXTS]
    return ModuleSource("\n".join(("import math\nimport numpy as np", *texts)), "", {})


def _entries() -> dict[str, tuple[object, ...]]:
    """Arguments of the kinds that the kernels are given."""
    one, two, three = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1, 1))
    index, pair = np.zeros(1, np.int64), np.zeros((1, 1), np.int64)
    model, room = MODEL_KIND, (two, three, three, pair)
    cost, bounds = (three, one, one, 0.1), (one, one)
    problem = (model, two, cost, bounds)
    settings = (0.1, 0.1, 0.1, 0.1, 0.1, 1, 0.1, 1, 0.1)
    expansion, plan = (three, three, two, three, two, two), (two, two, three)
    knots = (two, two, three, one, one, 0.1)
    products = (pair, index)
    return {
        "room_for": (1, 1, model),
        "slope_jacobian": (one, two, model, room, one, two),
        "tick_jacobian": (one, two, model, room, one, two),
        "expand": (*problem, two, two, expansion, two),
        "backward": (expansion, two, 0.1, two, three),
        "rolled": (*problem, 0.1, plan, (two, two)),
        "descend": (*problem, settings, two, two, three, two, 0.1),
        "noise_aware": (expansion, (0.1, 1, 0.1), three, three, two, two),
        "imagine": (model, three, cost, bounds, plan, two, three, three, one),
        "imagine_knots": (model, three, cost, bounds, knots, two, three, three, one),
        "ticks": (three, three, model, three),
        "tick_jacobians": (two, two, model, two, three),
        "policy_cost": (*problem, products, two, two),
        "policy_expansion": (*problem, products, two, two, one, two),
    }


@lru_cache(maxsize=1)
def kernels() -> Mapping[str, Callable[..., Any]]:
    """The kernels by name, compiled, or fetched from disk.

    Raises Unavailable, in one line, where numba is missing or has been set up otherwise.
    """
    entries = _entries()
    found = load_kernel(planner_source(), entries, "the planner")
    return MappingProxyType(dict(zip(entries, found, strict=True)))
