"""A frozen policy on numpy, one state at a time: there, torch's calls cost more than their work."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from numpy.typing import NDArray

from edtorch.types import Parameters

Arrays = Mapping[str, NDArray[Any]]
"""Parameters of one policy, without the axis of the population."""

Law = Callable[[NDArray[Any]], NDArray[Any]]
"""A function of a vector, as the action ``[m]`` of what a policy takes, ``[n]``."""


def law_of(actor: object, parameters: Parameters) -> Law | None:
    """What ``actor.action`` does with parameters ``[1, ...]``, to rounding; None for an actor that
    offers no ``law``."""
    offered = getattr(actor, "law", None)
    if offered is None:
        return None
    return offered({name: p[0].detach().numpy() for name, p in parameters.items()})
