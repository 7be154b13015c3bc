"""Proximal policy optimisation (J. Schulman et al., 2017), as stable-baselines3 has it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from edtorch.rivals.base import Problem, Search
from edtorch.rivals.deep import DeepSettings, at_least_one

if TYPE_CHECKING:
    import stable_baselines3
    from stable_baselines3.common.vec_env import VecEnv

BATCH = 64
"""Decisions in a minibatch: stable-baselines3's default."""


@dataclass(frozen=True)
class PPO(DeepSettings):
    """See ``DeepSettings``; copies: episodes side by side; rollout: decisions of each copy from one
    update to the next.  A piece of work is rounded up to whole rollouts."""

    steps: int = 16_384
    hidden: list[int] = field(default_factory=lambda: [64, 64])
    copies: int = 8
    rollout: int = 2_048

    def __post_init__(self) -> None:
        """As ``DeepSettings``."""
        for name in ("copies", "rollout"):
            at_least_one(name, getattr(self, name))
        if self.copies * self.rollout % BATCH:
            raise ValueError(
                f"rollout={self.rollout}: expected a number that times copies={self.copies} is a"
                f" multiple of {BATCH}, the size of a minibatch"
            )
        super().__post_init__()

    def begin(self, problem: Problem) -> Search:
        """One model per seed."""
        from edtorch.rivals.stable_baselines import BaselinesSearch

        return BaselinesSearch(
            problem,
            self.lesson(self.copies),
            self.piece,
            self._model,
            _layers,
            torch.tanh,
            _clipped,
        )

    def _model(self, envs: VecEnv, seed: int) -> stable_baselines3.PPO:
        import stable_baselines3

        return stable_baselines3.PPO(
            "MlpPolicy",
            envs,
            n_steps=self.rollout,
            batch_size=BATCH,
            learning_rate=self.learning_rate,
            gamma=self.discount,
            policy_kwargs={"net_arch": list(self.hidden)},
            seed=seed,
            device="cpu",
        )


def _clipped(action: Tensor) -> Tensor:
    return action.clamp(-1.0, 1.0)


def _layers(model: Any) -> list[nn.Linear]:
    """Of the mean of the Gaussian, which is clipped."""
    modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    return [module for module in modules if isinstance(module, nn.Linear)]
