"""Which components of an observation are joints, rates, the rest of the body, and the goal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from sims.base import Spec, spec_index


@dataclass(frozen=True)
class Layout:
    """The mechanical reading of a domain with a goal.

    A state is s = (q, o, dq, do), in physical units, ``[*batch, 2 (n + p)]``: q the n components
    that the goal is for (``Spec.tracked``: the joints), o the p other ones that have a rate (the
    base), and the rates of both.  g is the goal of q.
    """

    spec: Spec

    def __post_init__(self) -> None:
        spec = self.spec
        if not spec.goal:
            raise ValueError(f"domain {spec.name}: expected a domain with a goal (Spec.goal)")
        if len(spec.action) != len(spec.tracked):
            raise ValueError(
                f"domain {spec.name}: expected as many actions as tracked components,"
                f" {len(spec.tracked)}, not {len(spec.action)}"
            )
        rates = self._rates
        for quantity in spec.state:
            known = quantity.name in rates or quantity.name in spec.goal or quantity.rate_of
            if not known:
                raise ValueError(
                    f"domain {spec.name}: expected a rate of {quantity.name}, which an inverse"
                    " model of accelerations needs"
                )

    @cached_property
    def _rates(self) -> dict[str, str]:
        return {q.rate_of: q.name for q in self.spec.state if q.rate_of}

    @cached_property
    def names(self) -> list[str]:
        """Of the components of s, in order."""
        tracked = list(self.spec.tracked)
        other = [name for name in self._rates if name not in tracked]
        positions = tracked + other
        return positions + [self._rates[name] for name in positions]

    @property
    def joints(self) -> int:
        """n."""
        return len(self.spec.tracked)

    @property
    def others(self) -> int:
        """p."""
        return len(self.names) // 2 - self.joints

    @property
    def size(self) -> int:
        """2 (n + p)."""
        return len(self.names)

    @cached_property
    def scale(self) -> Tensor:
        """Divisors of s that make it of order one, ``[2 (n + p)]``."""
        by_name = {q.name: q.scale for q in self.spec.state}
        return torch.tensor([by_name[name] for name in self.names], dtype=torch.float64)

    @cached_property
    def angles(self) -> list[int]:
        """Which positions of s are angles."""
        units = {q.name: q.unit for q in self.spec.state}
        return [k for k, name in enumerate(self.names[: self.size // 2]) if units[name] == "rad"]

    @cached_property
    def _taken(self) -> tuple[Tensor, Tensor]:
        index = torch.tensor(spec_index(self.spec, [*self.names, *self.spec.goal]))
        scales = torch.tensor([q.scale for q in self.spec.state], dtype=torch.float64)
        return index, scales[index]

    def split(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """s ``[*batch, 2 (n + p)]`` and g ``[*batch, n]`` in physical units, from a scaled
        observation ``[*batch, N]``."""
        index, scale = self._taken
        physical = observation[..., index] * scale.to(observation)
        return physical[..., : self.size], physical[..., self.size :]
