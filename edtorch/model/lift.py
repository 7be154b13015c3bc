"""The lift of a state and an action: angles as points of the unit circle, the rest as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edtorch.law import Law
from edtorch.model.told import Told


@dataclass(frozen=True, eq=False)
class Lift:
    """A(s, u) = [1 | sin and cos of s_i unit_i for an angle, else s_i, for each i | u].

    angle: bool ``[n]``; at: int64 ``[n]``, the first entry of each component; unit: float64
    ``[n]``, the scale of the component (rad for an angle); action_at: the first entry of u; names:
    of the ``size`` entries.  States and actions are in scaled units.
    """

    angle: np.ndarray
    at: np.ndarray
    unit: np.ndarray
    action_at: int
    names: tuple[str, ...]

    @classmethod
    def of(cls, told: Told) -> Lift:
        """The lift of the components and actions of ``told``."""
        names, at = ["1"], []
        for name, angle in zip(told.names, told.angle, strict=True):
            at.append(len(names))
            names += [f"sin {name}", f"cos {name}"] if angle else [name]
        return cls(
            angle=np.array(told.angle, dtype=np.bool_),
            at=np.array(at, dtype=np.int64),
            unit=np.array(told.unit, dtype=np.float64),
            action_at=len(names),
            names=(*names, *told.actions),
        )

    @property
    def size(self) -> int:
        """How many entries A has."""
        return len(self.names)

    @property
    def states(self) -> int:
        """n."""
        return len(self.at)

    @property
    def actions(self) -> int:
        """m."""
        return self.size - self.action_at

    def entry(self, name: str) -> int:
        """The index of an entry; ValueError for an unknown name."""
        if name not in self.names:
            raise ValueError(f"entry={name!r}: expected one of {', '.join(self.names)}")
        return self.names.index(name)

    def entries_of(self, components: Sequence[int]) -> list[int]:
        """The entries that these components of the state have, in order."""
        first = [int(self.at[i]) for i in components]
        pairs = [int(self.at[i]) + 1 for i in components if self.angle[i]]
        return sorted(first + pairs)

    def of_state(self, state: Tensor) -> Tensor:
        """A ``[*batch, size]`` of a state ``[*batch, n]`` with the action 0."""
        return self(state, state.new_zeros(*state.shape[:-1], self.actions))

    def __call__(self, state: Tensor, action: Tensor) -> Tensor:
        """A ``[*batch, size]`` of state ``[*batch, n]`` and action ``[*batch, m]``."""
        angles, unit, order = self._places
        radians = state.index_select(-1, angles) * unit
        one = torch.ones_like(state[..., :1])
        found = torch.cat([one, state, action, radians.sin(), radians.cos()], dim=-1)
        return found.index_select(-1, order)

    def law(self, entries: NDArray[Any] | None = None) -> Law:
        """``of_state`` of one state ``[n]`` (``edtorch.law``), of these entries or all."""
        angles, unit, order = (each.numpy() for each in self._places)
        order = order if entries is None else order[entries]
        one, action = np.ones(1), np.zeros(self.actions)

        def lifted(state: NDArray[Any]) -> NDArray[Any]:
            radians = state[angles] * unit
            parts = (one, state, action, np.sin(radians), np.cos(radians))
            return np.concatenate(parts)[order]

        return lifted

    def jacobian(self, state: Tensor, action: Tensor) -> Tensor:
        """d A / d (s, u), ``[*batch, size, n + m]``."""
        n, m, batch = self.states, self.actions, state.shape[:-1]
        found = state.new_zeros(*batch, self.size, n + m)
        unit = torch.from_numpy(self.unit)
        for i, (at, angle) in enumerate(zip(self.at, self.angle, strict=True)):
            if angle:
                radians = state[..., i] * unit[i]
                found[..., at, i] = unit[i] * radians.cos()
                found[..., at + 1, i] = -unit[i] * radians.sin()
            else:
                found[..., at, i] = 1.0
        for k in range(m):
            found[..., self.action_at + k, n + k] = 1.0
        return found

    @cached_property
    def _places(self) -> tuple[Tensor, Tensor, Tensor]:
        """Which components are angles, their units, and where each entry is in
        [1 | s | u | sines | cosines]."""
        n, m = self.states, self.actions
        sine = 1 + n + m + np.cumsum(self.angle) - 1
        order = np.zeros(self.size, dtype=np.int64)
        order[self.at] = np.where(self.angle, sine, 1 + np.arange(n))
        order[self.at[self.angle] + 1] = sine[self.angle] + self.angle.sum()
        order[self.action_at :] = 1 + n + np.arange(m)
        found = (np.flatnonzero(self.angle), self.unit[self.angle], order)
        with torch.inference_mode(False):  # they outlive the call that asks first
            angles, unit, places = (torch.from_numpy(each) for each in found)
        return angles, unit, places
