"""Small populations on the bicycle, of three kinds."""

from __future__ import annotations

from typing import Literal

import torch

from edtorch.learner.annealing import Annealed
from edtorch.learner.learner import Learner
from edtorch.learner.limit import Ramp, Safe
from edtorch.learner.schedule import ALWAYS, Schedule
from edtorch.model.features import Affine, Identity
from edtorch.model.fit import RecursiveLeastSquares, SquaredError
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import SaturatedStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.transform import FirstOrder, MeanOnly
from edtorch.types import replace
from edtorch.value.choose import choose_path
from edtorch.value.unroll import FromOrigin, Horizon
from sims.bicycle import Bicycle

Kind = Literal["plain", "rich", "cautious"]


def bicycle_training(seeds: list[int], budget: Budget, *, kind: Kind = "plain") -> Training:
    """Learners on the bicycle with a short horizon.

    rich: with a constant term, least squares, covariance, noise, a start belief and action cost;
    cautious: what a learner that must not fall has besides.
    """
    cautious, rich = kind == "cautious", kind != "plain"
    world = World(Bicycle(), unwrap=1.5 if cautious else None)
    n, m = len(world.spec.state), len(world.spec.action)
    model = DerivativeModel(n, m, (Affine if kind == "rich" else Identity)(n + m), world.period)
    policy = LinearPolicy(n, m, Identity(n))
    eye = torch.eye(n, dtype=torch.float64)
    R = (0.1 if rich else 0.0) * torch.eye(m, dtype=torch.float64)
    noise = ResidualNoise(1.0) if rich else None
    choice = choose_path(
        "closed_form",
        model,
        policy,
        QuadraticReward(eye, R),
        FirstOrder() if rich else MeanOnly(),
        Horizon(4, 0.051, 0.9, 0.051),
        noise=noise,
        start_cov=0.01 * eye,
    )
    learner = Learner(
        model=model,
        policy=policy,
        fit=RecursiveLeastSquares() if rich else SquaredError(10.0),
        noise=noise,
        value=choice.path,
        step_rule=SaturatedStep(0.3, 1.0),
        exploration=0.05,
    )
    schedule = ALWAYS
    if cautious:
        schedule = Schedule(first=10, often=40, every=16)
        share = Annealed(0.3, 0.7, 100.0)
        ramp = Ramp(n - 1, n, Annealed(0.1, 1.0, 100.0), torch.float64)
        learner = replace(
            learner,
            value=FromOrigin(learner.value),
            exploration=Annealed(0.5, 0.05, 30.0),
            command=Safe(ramp, model, policy, noise, 0.051, 4, ((0, 1.0),), share, deviations=0.5),
        )
    return Training(learner, world, seeds, budget, schedule=schedule)
