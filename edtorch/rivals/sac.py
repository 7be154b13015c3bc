"""Soft actor-critic (T. Haarnoja et al., ICML 2018), as stable-baselines3 has it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from torch import nn
from torch.nn.functional import relu

from edtorch.rivals.base import Problem, Search
from edtorch.rivals.deep import DeepSettings

if TYPE_CHECKING:
    import stable_baselines3
    from stable_baselines3.common.vec_env import VecEnv


@dataclass(frozen=True)
class SAC(DeepSettings):
    """See ``DeepSettings``; one episode at a time, an update after every decision."""

    steps: int = 5_000
    hidden: list[int] = field(default_factory=lambda: [256, 256])

    def begin(self, problem: Problem) -> Search:
        """One model per seed."""
        from edtorch.rivals.stable_baselines import BaselinesSearch

        return BaselinesSearch(
            problem, self.lesson(1), self.piece, self._model, _layers, relu, torch.tanh
        )

    def _model(self, envs: VecEnv, seed: int) -> stable_baselines3.SAC:
        import stable_baselines3

        return stable_baselines3.SAC(
            "MlpPolicy",
            envs,
            learning_rate=self.learning_rate,
            gamma=self.discount,
            policy_kwargs={"net_arch": list(self.hidden)},
            seed=seed,
            device="cpu",
        )


def _layers(model: Any) -> list[nn.Linear]:
    """Of the mean of the Gaussian, which tanh squashes."""
    modules = [*model.actor.latent_pi, model.actor.mu]
    return [module for module in modules if isinstance(module, nn.Linear)]
