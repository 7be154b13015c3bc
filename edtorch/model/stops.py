"""Stops: what positions cannot go beyond, as unilateral constraints on a model of free motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from edtorch.model.mechanism import Structure
from edtorch.model.told import Told

BEHIND = 0.125
"""Of a turn: as far beyond a stop an angle is taken to have gone too far, not nearly all around."""
MOST_STOPS = 6
"""Their forces are found by trying every set of them."""


@dataclass(frozen=True, eq=False)
class Stops:
    """g_k(s) = normal_k . s - level_k >= 0, inelastic, k of K.

    A stop acts like the action ``column_k``: its force and its impulse change the learned
    derivatives along df/du_column(k), with the sign that opens it, as much as the gap needs to stay
    at zero (``edtorch/search/kernels/stops.py``).

    names: of the stops; unit ``[K]``: the scale of the first position that each names; normal
    ``[K, n]``, level ``[K]``, nan where it is to be learned: in those units; turn ``[K]``: 2 pi in
    them where the gap is an angle, else 0; column: int64 ``[K]``.
    """

    names: tuple[str, ...]
    unit: np.ndarray
    normal: np.ndarray
    level: np.ndarray
    turn: np.ndarray
    column: np.ndarray

    @classmethod
    def none(cls, states: int) -> Stops:
        """No stop at all, of a state of that many components."""
        zero = np.zeros(0)
        return cls((), zero, np.zeros((0, states)), zero, zero, np.zeros(0, np.int64))

    @classmethod
    def of(cls, told: Told, given: Mapping[str, object]) -> Stops:
        """Stops by name: ``of`` {position: factor}, physical; ``column`` an action; ``at`` the
        level of the sum, physical, None where it is to be learned.

        Raises ValueError for unknown names, for components whose rate is not learned, and for two
        that contradict each other.
        """
        count, n = len(given), len(told.names)
        if count > MOST_STOPS:
            raise ValueError(f"told.stops: {count} of them, expected {MOST_STOPS} at most")
        shapes = (count, (count, n), count, count, count)
        found = cls(tuple(given), *(np.zeros(shape) for shape in shapes))
        for k, (name, entry) in enumerate(given.items()):
            key = f"told.stops.{name}"
            told_so = dict(entry) if isinstance(entry, Mapping) else {}
            unknown = sorted(set(told_so) - {"of", "column", "at"})
            if unknown or not isinstance(told_so.get("of"), Mapping) or "column" not in told_so:
                raise ValueError(
                    f"{key}={entry}: expected {{of: {{position: factor}}, column: an action, at: a"
                    " level, or null to learn it}"
                )
            _place(found, k, key, told_so, told)
        for k in range(count):
            for j in range(k):
                opposite = np.allclose(found.normal[j], -found.normal[k])
                if opposite and found.level[j] + found.level[k] >= 0:
                    lower, upper = (
                        f"told.stops.{found.names[i]}.at={found.physical[i]:g}" for i in (j, k)
                    )
                    raise ValueError(
                        f"{lower}, {upper}: no room between these stops, which bound opposite sums;"
                        " expected levels that add up to a number < 0"
                    )
        return replace(found, column=found.column.astype(np.int64))

    def __len__(self) -> int:
        return len(self.names)

    def kept(self, which: np.ndarray) -> Stops:
        """Some of them, by bool ``[K]``."""
        names = tuple(name for name, kept in zip(self.names, which, strict=True) if kept)
        parts = (self.unit, self.normal, self.level, self.turn, self.column)
        return Stops(names, *(part[which] for part in parts))

    def by_learned(self, structure: Structure) -> np.ndarray:
        """``[K, L]``: dg/dt = this times what the model learns the derivative of.

        Raises ValueError for a position whose rate is not learned.
        """
        rates = self.normal * structure.ratio
        table = np.zeros((len(self), len(structure.learned)))
        for k, i in zip(*np.nonzero(self.normal), strict=True):
            place = np.flatnonzero(structure.learned == structure.source[i])
            if structure.source[i] < 0 or not len(place):
                raise ValueError(
                    f"told.stops.{self.names[k]}: expected positions whose rates are told"
                    f" (told.rates) and learned; component {i} has none"
                )
            table[k, place[0]] += rates[k, i]
        return table

    def gaps(self, state: Tensor) -> Tensor:
        """g ``[*batch, K]`` of states ``[*batch, n]``; of an angle, from ``BEHIND`` of a turn
        beyond the stop on."""
        normal, level, turn = (torch.from_numpy(a) for a in (self.normal, self.level, self.turn))
        gap = (normal * state.unsqueeze(-2)).sum(-1) - level
        whole = torch.where(turn > 0, turn, torch.ones_like(turn))
        around = gap - whole * (gap / whole + BEHIND).floor()
        return torch.where(turn > 0, around, gap)

    @property
    def physical(self) -> np.ndarray:
        """``level`` in physical units, as it is told."""
        return self.level * self.unit

    @property
    def words(self) -> str:
        """The stops with their levels in physical units, in a cell of a table."""
        levels = ["learned" if np.isnan(level) else f"{level:g}" for level in self.physical]
        return ", ".join(f"{name} {at}" for name, at in zip(self.names, levels, strict=True))


def _place(stops: Stops, k: int, key: str, entry: Mapping[str, object], told: Told) -> None:
    """Write stop k.  Raises ValueError."""
    of = entry["of"]
    assert isinstance(of, Mapping)
    first = 0.0
    for name, factor in of.items():
        if name not in told.names:
            raise ValueError(
                f"{key}.of: {name!r} is no component of the state; expected one of"
                f" {', '.join(told.names)}"
            )
        i = told.names.index(name)
        if told.rate[i] < 0 or told.rate[i] not in told.learned:
            raise ValueError(f"{key}.of: {name!r} has no learned rate; tell it in told.rates")
        if not isinstance(factor, (int, float)) or factor == 0:
            raise ValueError(f"{key}.of.{name}={factor}: expected a number other than 0")
        first = first or told.unit[i]
        stops.unit[k] = first
        stops.normal[k, i] = factor * told.unit[i] / first
        if told.angle[i] and abs(factor) == 1:
            stops.turn[k] = 2 * np.pi / first
    if not first:
        raise ValueError(f"{key}.of: expected a position")
    if entry["column"] not in told.actions:
        raise ValueError(
            f"{key}.column={entry['column']}: expected one of {', '.join(told.actions)}"
        )
    stops.column[k] = told.actions.index(str(entry["column"]))
    level = entry.get("at")
    if level is not None and not isinstance(level, (int, float)):
        raise ValueError(f"{key}.at={level}: expected a number, or null to learn it")
    stops.level[k] = np.nan if level is None else level / first
