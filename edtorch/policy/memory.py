"""What a policy may need beside an observation: what it remembers of its episode."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from edtorch.types import Parameters, Transition


class EpisodeMemory(Protocol):
    """What acts with a frozen policy: it turns observations into what the policy takes.

    What it keeps of an episode is a mapping of tensors ``[B, ...]``; parameters: those of the
    policies, ``[B, ...]`` each.
    """

    def initial(self, observation: Tensor, /) -> Parameters:
        """What is kept at the beginning of an episode, from its first observation ``[B, n]``."""
        ...

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor, /) -> Parameters:
        """New episodes for those that are ``fresh`` ``[B]``."""
        ...

    def now(self, parameters: Parameters, memory: Parameters, observation: Tensor, /) -> Tensor:
        """What the policy takes at this moment, ``[B, ...]``."""
        ...

    def follow(
        self, parameters: Parameters, memory: Parameters, transition: Transition, /
    ) -> Parameters:
        """What is kept after a tick."""
        ...
