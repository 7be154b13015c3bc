"""What acts in the first trials of a search: sources of actions (``edtorch.run.tick``) that learn
nothing."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.policy.policies import Policy
from edtorch.types import Parameters, Transition


@dataclass(frozen=True)
class RandomActions:
    """Actions uniform within middle +- half ``[m]``, scaled, each of which lasts for ``held``
    ticks."""

    middle: Tensor
    half: Tensor
    held: int = 1

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor, /) -> Parameters:
        """As before: an action goes on over the end of an episode."""
        return memory

    def act(self, memory: Parameters, observation: Tensor, normal: Tensor, /) -> Tensor:
        """Uniform, by the distribution function of the normal numbers."""
        drawn = self.middle + self.half * torch.erf(normal / 2**0.5)
        if not memory:
            return drawn
        fresh = memory["age"].remainder(self.held) == 0
        return torch.where(fresh.unsqueeze(-1), drawn, memory["action"])

    def step(
        self, memory: Parameters, transition: Transition, /, *, improve: bool
    ) -> tuple[Parameters, None]:
        """The action is remembered; nothing is learned."""
        age = memory["age"] + 1 if memory else torch.ones_like(transition.valid, dtype=torch.long)
        return {"action": transition.action, "age": age}, None


@dataclass(frozen=True)
class Perturbed:
    """Actions of a policy with noise: parameters ``[B, ...]``; deviation ``[m]``: of the noise,
    scaled."""

    policy: Policy
    parameters: Parameters
    deviation: Tensor

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor, /) -> Parameters:
        """Nothing is remembered."""
        return memory

    def act(self, memory: Parameters, observation: Tensor, normal: Tensor, /) -> Tensor:
        """The policy's action and the noise."""
        return self.policy.action(self.parameters, observation) + self.deviation * normal

    def step(
        self, memory: Parameters, transition: Transition, /, *, improve: bool
    ) -> tuple[Parameters, None]:
        """Nothing is learned."""
        return memory, None
