"""The time of an episode as a component of the state, for policies that depend on it."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.types import Parameters, Transition, select


class EpisodeClock:
    """Appends the ticks since the start of the episode to an observation: ``[B, n] -> [B, n + 1]``.

    Its memory: ``ticks`` ``[B]``, in the type of the observation (``edtorch.policy.memory.
    EpisodeMemory``).
    """

    def initial(self, observation: Tensor, /) -> Parameters:
        """Everybody at the start of an episode."""
        return {"ticks": torch.zeros_like(observation[..., 0])}

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor, /) -> Parameters:
        """New episodes for those that are ``fresh`` ``[B]``."""
        return {"ticks": select(fresh, torch.zeros_like(memory["ticks"]), memory["ticks"])}

    def now(self, parameters: Parameters, memory: Parameters, observation: Tensor, /) -> Tensor:
        """``[B, n + 1]``."""
        return torch.cat([observation, memory["ticks"].unsqueeze(-1)], dim=-1)

    def follow(
        self, parameters: Parameters, memory: Parameters, transition: Transition, /
    ) -> Parameters:
        """A tick later."""
        return {"ticks": memory["ticks"] + 1}
