"""The data of a search: readings of all trials, and the last plans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from edtorch.types import Parameters, Transition

WARM = 3
"""Number of the last plans that are kept to start from."""


@dataclass(frozen=True)
class Knowledge:
    """readings: of each trial ``[T + 1, n]``; actions ``[T, m]``, valid ``[T]``, all scaled; plans:
    ``raw`` actions ``[H, m]`` of the last plans that were executed, or parameters of the last
    policies, by name, the last one first."""

    readings: Sequence[Tensor] = ()
    actions: Sequence[Tensor] = ()
    valid: Sequence[Tensor] = ()
    plans: Sequence[Parameters] = ()

    def with_trial(self, readings: Tensor, actions: Tensor, valid: Tensor) -> Knowledge:
        """One trial more."""
        return replace(
            self,
            readings=[*self.readings, readings],
            actions=[*self.actions, actions],
            valid=[*self.valid, valid],
        )

    def with_plan(self, plan: Parameters) -> Knowledge:
        """One plan more."""
        return replace(self, plans=[plan, *self.plans][:WARM])

    def transitions(self, dt: float) -> Transition:
        """The transitions of all trials; ``valid`` says which count."""
        like = self.readings[0]
        return Transition(
            state=torch.cat([r[:-1] for r in self.readings]),
            action=torch.cat(list(self.actions)),
            next_state=torch.cat([r[1:] for r in self.readings]),
            dt=torch.tensor(dt, dtype=like.dtype),
            valid=torch.cat(list(self.valid)),
        )

    @property
    def trial(self) -> Tensor:
        """The number ``[N]`` of the trial of each transition."""
        lengths = torch.tensor([len(own) for own in self.actions])
        return torch.repeat_interleave(torch.arange(len(lengths)), lengths)

    def state(self) -> dict[str, Any]:
        """For ``edtorch.run.state_file``."""
        return {name: list(getattr(self, name)) for name in _FIELDS}

    @classmethod
    def of_state(cls, state: Mapping[str, Any]) -> Knowledge:
        """From such a state."""
        return cls(**{name: list(state[name]) for name in _FIELDS})


_FIELDS = ("readings", "actions", "valid", "plans")
