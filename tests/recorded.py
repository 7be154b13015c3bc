"""Recorded transitions that several tests share."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from edtorch.learner.learner import Learner
from edtorch.learner.schedule import Schedule
from edtorch.model.features import Identity
from edtorch.model.fit import Fit, RecursiveLeastSquares
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import FullStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.recorder import Recorder
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.run.transitions_file import Recorded, gathered
from edtorch.value.linear.regulator import Regulator
from edtorch.value.unroll import Horizon
from sims.linear import LinearSystem
from tests.systems import f64, next_state_model

F = [[1.1, 0.2], [-0.1, 0.9]]
G = [[0.0], [0.5]]
Q, R = torch.diag(f64([1.0, 0.3])), f64([[0.2]])
NEVER = Schedule(first=10**9)


def linear_world(noise: float = 0.0) -> World:
    """Two states, one action, unstable; episodes of eight steps."""
    return World(LinearSystem(F, G, noise=noise, time_limit=8.0))


def linear_learner(fit: Fit | None = None, steps: int = 80) -> Learner:
    """Learns that system's model, and takes its regulator for a policy."""
    model, policy = next_state_model(2, 1), LinearPolicy(2, 1, Identity(2))
    path = Regulator(
        model, policy, QuadraticReward(Q, R), Horizon(steps, 1.0, 1.0, 1.0), torch.eye(2).double()
    )
    fit = fit or RecursiveLeastSquares(prior=1e10)
    return Learner(model, policy, fit, None, path, FullStep(), exploration=1.0)


def lived(
    world: World, learner: Learner, seeds: Sequence[int], seconds: float
) -> tuple[Training, Recorded]:
    """Learners whose policy is never improved, and what they have lived through."""
    recorder = Recorder(world, len(seeds))
    budget = Budget(seconds=seconds)
    training = Training(learner, world, seeds, budget, schedule=NEVER, recorder=recorder)
    while not training.done:
        training.advance(700)
    lives = [recorder.lived(row) for row in range(len(seeds))]
    return training, gathered(lives, seeds, world.dt)
