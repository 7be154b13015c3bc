"""Prior knowledge of a system's components; none of it is inferred from data."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from sims.base import Quantity, Spec


@dataclass(frozen=True)
class Told:
    """Prior knowledge of the n components of the state, in the order of ``names``.

    unit: the scale by which the learner's states are divided; angle: whether it is one, in rad
    before it is divided; rate_of: index of the component whose time derivative it is, -1 if none;
    constant: it does not change during an episode; ignored: neither learned nor used; invariant:
    the dynamics do not depend on it.  actions: names of the m components of the action.
    """

    names: tuple[str, ...]
    unit: tuple[float, ...]
    angle: tuple[bool, ...]
    rate_of: tuple[int, ...]
    actions: tuple[str, ...]
    constant: frozenset[str] = frozenset()
    ignored: frozenset[str] = frozenset()
    invariant: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for key in ("constant", "ignored", "invariant"):
            _known(key, getattr(self, key), self.names)
        _consistent(self)

    @classmethod
    def of(
        cls,
        spec: Spec,
        angles: Collection[str] = (),
        rates: Mapping[str, str] | None = None,
        constant: Collection[str] = (),
        ignored: Collection[str] = (),
        invariant: Collection[str] = (),
    ) -> Told:
        """Prior knowledge from ``spec``, and by name beside it.

        spec: ``Quantity.period`` of 2 pi (an angle), ``Quantity.rate_of``, ``Spec.goal``
        (constant); rates: {rate: component that it is the derivative of}.  Raises ValueError for
        unknown names and for what cannot be true together.
        """
        names = tuple(quantity.name for quantity in spec.state)
        rates = dict(rates or {})
        _known("angles", angles, names)
        _known("rates", [*rates, *rates.values()], names)
        named = {quantity.name: quantity.rate_of for quantity in spec.state if quantity.rate_of}
        of_what = named | rates
        return cls(
            names=names,
            unit=tuple(float(quantity.scale) for quantity in spec.state),
            angle=tuple(_is_angle(quantity, angles) for quantity in spec.state),
            rate_of=tuple(names.index(of_what[n]) if n in of_what else -1 for n in names),
            actions=tuple(quantity.name for quantity in spec.action),
            constant=frozenset(constant) | frozenset(spec.goal),
            ignored=frozenset(ignored),
            invariant=frozenset(invariant),
        )

    @property
    def rate(self) -> tuple[int, ...]:
        """The inverse of ``rate_of``: index of each component's rate, -1 where none is told, and
        where the component is ignored."""
        told = {of: i for i, of in enumerate(self.rate_of) if of >= 0}
        return tuple(
            -1 if name in self.ignored else told.get(i, -1) for i, name in enumerate(self.names)
        )

    @property
    def learned(self) -> tuple[int, ...]:
        """The L components whose derivative is learned: that of any other is told."""
        still = self.constant | self.ignored
        rate = self.rate
        return tuple(i for i, name in enumerate(self.names) if name not in still and rate[i] < 0)

    @property
    def acting(self) -> tuple[int, ...]:
        """The components that the dynamics may depend on."""
        out = self.ignored | self.invariant
        return tuple(i for i, name in enumerate(self.names) if name not in out)

    @property
    def words(self) -> str:
        """The prior knowledge, in a cell of a table."""
        angles = [name for name, angle in zip(self.names, self.angle, strict=True) if angle]
        rates = [
            f"{name} of {self.names[of]}"
            for name, of in zip(self.names, self.rate_of, strict=True)
            if of >= 0
        ]
        parts = {
            "angles": angles,
            "rates": rates,
            **{
                key: [name for name in self.names if name in getattr(self, key)]
                for key in ("constant", "ignored", "invariant")
            },
        }
        told = [f"{key}: {', '.join(found)}" for key, found in parts.items() if found]
        return "; ".join(told) or "nothing"


def _known(key: str, told: Collection[str], names: tuple[str, ...]) -> None:
    for name in told:
        if name not in names:
            raise ValueError(
                f"told.{key}={name!r}: no component of the state; expected one of"
                f" {', '.join(names)}"
            )


def _is_angle(quantity: Quantity, angles: Collection[str]) -> bool:
    turn = 2 * math.pi
    if quantity.period and not math.isclose(quantity.period, turn, rel_tol=1e-6):
        raise ValueError(
            f"the period of {quantity.name!r} is {quantity.period} {quantity.unit}: expected an"
            " angle in rad, of period 2 pi, or none"
        )
    return quantity.period > 0 or quantity.name in angles


def _consistent(told: Told) -> None:
    """Raises ValueError, of one line, for what cannot be true together."""
    found: dict[int, str] = {}
    for i, (name, of) in enumerate(zip(told.names, told.rate_of, strict=True)):
        if of < 0:
            continue
        position = told.names[of]
        what = f"told.rates: {name!r} is the rate of {position!r}"
        if of in found:
            raise ValueError(f"{what}, and {found[of]!r} is as well: expected one rate")
        found[of] = name
        if told.angle[i]:
            raise ValueError(f"{what}: expected no angle, which {name!r} is told to be")
        if position in told.constant:
            raise ValueError(f"{what}, which is told to be constant: expected one of the two")
        if name in told.ignored and position not in told.ignored:
            raise ValueError(f"{what}: expected both ignored, or none; {name!r} alone is")
        if _circular(told.rate_of, i):
            raise ValueError(f"{what}, which comes back to {name!r}: expected rates without a ring")
    for first, second in (("constant", "ignored"), ("ignored", "invariant")):
        both = sorted(getattr(told, first) & getattr(told, second))
        if both:
            raise ValueError(
                f"told.{first} and told.{second}: {both[0]!r} is in both, expected one of them"
            )
    if not told.learned:
        raise ValueError("told: every component is constant, ignored or has a rate: none to learn")


def _circular(rate_of: tuple[int, ...], start: int) -> bool:
    at = rate_of[start]
    for _ in rate_of:
        if at < 0 or at == start:
            break
        at = rate_of[at]
    return at == start
