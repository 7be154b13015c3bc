"""Angles among the components of an observation, as a view of it: pure functions.

An angle arrives either as a component of its own, in radians or degrees, which the view wraps, or
as a pair of cosine and sine, which the view replaces by the one angle between them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from sims.angles import atan2
from sims.base import Quantity

PERIODS = {"rad": 2 * math.pi, "deg": 360.0}

Angles = Sequence[str] | Mapping[str, Any]
"""Names of components in radians; or by name a unit, a pair (cosine, sine) of names, or a mapping
with ``unit`` or ``pair``, and ``around``."""


@dataclass(frozen=True)
class Component:
    """One component of the view; sources: its place in the observation, or the places of cosine and
    sine; period: of an angle, 0 for anything else; around: the angle in the middle of the range
    (around - period / 2, around + period / 2]."""

    sources: tuple[int, ...]
    period: float = 0.0
    around: float = 0.0


@dataclass(frozen=True)
class AngleView:
    """The components of the view, in order."""

    components: tuple[Component, ...]

    def __call__(self, observation: Tensor) -> Tensor:
        """The view ``[*batch, n]`` of an observation ``[*batch, k]``."""
        return torch.stack([_value(c, observation) for c in self.components], dim=-1)


def _value(component: Component, observation: Tensor) -> Tensor:
    if len(component.sources) == 2:
        cosine, sine = (observation[..., k].contiguous() for k in component.sources)
        return wrapped(atan2(sine, cosine), component.period, component.around)
    value = observation[..., component.sources[0]]
    return wrapped(value, component.period, component.around) if component.period else value


def wrapped(angle: Tensor, period: float, around: float = 0.0) -> Tensor:
    """``angle`` plus a whole number of periods, in (around - period / 2, around + period / 2]."""
    return angle - period * torch.ceil((angle - around) / period - 0.5)


def angle_view(
    quantities: Sequence[Quantity], angles: Angles
) -> tuple[AngleView, tuple[Quantity, ...]]:
    """The view of an observation of ``quantities``, and the quantities of the view.

    A pair's angle, in radians, stands where the first of the two stood.  Raises ValueError for
    names that are not there, and for units other than rad and deg.
    """
    names = [q.name for q in quantities]
    wanted = dict(angles) if isinstance(angles, Mapping) else dict.fromkeys(angles, "rad")
    plain = {k: Component((k,)) for k in range(len(names))}
    seen = dict(enumerate(quantities))
    for name, given in wanted.items():
        unit, pair, around = _read(name, given)
        if pair is None:
            place = _place(names, name, name)
            plain[place] = Component((place,), PERIODS[unit], around)
            seen[place] = replace(seen[place], unit=unit, period=PERIODS[unit], middle=around)
            continue
        places = tuple(_place(names, name, each) for each in pair)
        if len(set(places)) < 2 or not all(p in plain and not plain[p].period for p in places):
            raise ValueError(f"angles.{name}={pair}: expected two components used only here")
        if name in (q.name for k, q in seen.items() if k not in places):
            raise ValueError(f"angles.{name}={pair}: expected a name that no component has")
        for place in places:
            del plain[place], seen[place]
        plain[min(places)] = Component(places, PERIODS["rad"], around)
        seen[min(places)] = Quantity(name, "rad", period=PERIODS["rad"], middle=around)
    order = sorted(plain)
    return AngleView(tuple(plain[k] for k in order)), tuple(seen[k] for k in order)


def _place(names: Sequence[str], angle: str, name: str) -> int:
    if name not in names:
        raise ValueError(f"angles.{angle}: {name!r} is not one of {', '.join(names)}")
    return names.index(name)


def _read(name: str, given: Any) -> tuple[str, tuple[str, ...] | None, float]:
    """Unit, pair and middle of the range from what stands for an angle."""
    known = {"unit", "pair", "around"}
    parts: dict[str, Any] = dict(given) if isinstance(given, Mapping) else {}
    if isinstance(given, str):
        parts = {"unit": given}
    elif isinstance(given, Sequence):
        parts = {"pair": given}
    unit, pair = parts.get("unit", "rad"), parts.get("pair")
    sound = bool(parts) and set(parts) <= known and unit in PERIODS
    if pair is not None:
        pair = tuple(pair)
        sound = sound and len(pair) == 2 and unit == "rad"
    around = float(parts.get("around", 0.0))
    if not (sound and math.isfinite(around)):
        raise ValueError(
            f"angles.{name}={given!r}: expected 'rad', 'deg', or the names of cosine and sine"
        )
    return unit, pair, around


def with_rates(quantities: Sequence[Quantity], rates: Mapping[str, str]) -> tuple[Quantity, ...]:
    """``quantities`` with ``rate_of`` set; rates: the component, by name of the rate of it."""
    names = [q.name for q in quantities]
    for rate, name in rates.items():
        for each in (rate, name):
            if each not in names:
                raise ValueError(f"rates.{rate}={name}: {each!r} is not one of {', '.join(names)}")
        if rate == name:
            raise ValueError(f"rates.{rate}={name}: expected another component")
    return tuple(replace(q, rate_of=rates.get(q.name, q.rate_of)) for q in quantities)
