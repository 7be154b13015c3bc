"""Recorded transitions that several tests share."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from edtorch.learner.learner import Learner
from edtorch.learner.schedule import Schedule
from edtorch.model.features import Identity
from edtorch.model.fit import Fit, RecursiveLeastSquares
from edtorch.model.models import DerivativeModel
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import FullStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.recorder import Recorder
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.run.transitions_file import Recorded, gathered
from edtorch.transform import FirstOrder
from edtorch.value.choose import choose_path
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


def derivative_learner(fit: Any, noise: Any, step: Any) -> Learner:
    """Of ds/dt = W (s, a), with the gradient of a short horizon."""
    model = DerivativeModel(2, 1, Identity(3), torch.zeros(2).double())
    policy = LinearPolicy(2, 1, Identity(2))
    path = choose_path(
        "auto",
        model,
        policy,
        QuadraticReward(Q, R),
        FirstOrder(),
        Horizon(3, 0.05, 1.0, 0.05),
        noise=noise,
        start_cov=torch.eye(2).double(),
    ).path
    return Learner(model, policy, fit, noise, path, step, exploration=0.0)


def lived(
    world: World, learner: Learner, seeds: Sequence[int], seconds: float
) -> tuple[Training, Recorded]:
    """Learners whose policy is never improved, and what they have lived through."""
    budget = Budget(seconds=seconds)
    with tempfile.TemporaryFile() as file:
        recorder = Recorder(world, len(seeds), file)
        training = Training(learner, world, seeds, budget, schedule=NEVER, recorder=recorder)
        while not training.done:
            training.advance(700)
        lives = [recorder.lived(row) for row in range(len(seeds))]
    return training, gathered(lives, seeds, world.dt)


def linear_arrays(
    episodes: int = 10, rows: int = 4, dt: float | np.ndarray = 0.01, **changes: Any
) -> dict[str, Any]:
    """The content of a file of transitions of s' = [[1, .02], [0, 1]] s + [0, .06] a in the linear
    domain; changes: of arrays, by name, and of ``meta``."""
    generator = np.random.default_rng(0)
    size = episodes * rows
    state, action = np.zeros((size, 2)), generator.normal(size=(size, 1))
    next_state = np.zeros((size, 2))
    for row in range(size):
        state[row] = next_state[row - 1] if row % rows else generator.normal(size=2)
        next_state[row] = [
            state[row, 0] + 0.02 * state[row, 1],
            state[row, 1] + 0.06 * action[row, 0],
        ]
    meta = {
        "format": 1,
        "domain": "linear",
        "units": "physical",
        "state": [{"name": "state_0"}, {"name": "state_1"}],
        "action": [{"name": "action_0"}],
    }
    arrays = {
        "state": state,
        "action": action,
        "next_state": next_state,
        "dt": np.broadcast_to(dt, size).copy(),
        "episode": np.arange(size) // rows,
        "terminated": np.zeros(size, dtype=bool),
        "truncated": np.arange(size) % rows == rows - 1,
    }
    return arrays | changes | {"meta": json.dumps(meta | changes.get("meta", {}))}
