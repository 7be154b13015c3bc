"""Small worlds, learners and random systems that several tests share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from edtorch.learner.learner import Learner
from edtorch.model.features import FeatureMap, Identity
from edtorch.model.fit import Fit, SquaredError
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import SaturatedStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.transform import MeanOnly
from edtorch.value.choose import Method, choose_path
from edtorch.value.linear import LinearMeanOnly
from edtorch.value.unroll import Generic, Horizon, ValueGradient
from sims.base import Sim
from sims.bicycle import Bicycle


def normal(generator: torch.Generator, *shape: int) -> Tensor:
    """Standard normal float64 numbers."""
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def f64(numbers: Sequence[Any]) -> Tensor:
    """A float64 tensor."""
    return torch.tensor(numbers, dtype=torch.float64)


def random_cost(generator: torch.Generator, n: int) -> Tensor:
    """A positive definite matrix."""
    root = normal(generator, n, n)
    return root @ root.T / n


Features = Callable[[int], FeatureMap]


@dataclass(frozen=True)
class LinearCase:
    """A random linear problem for a batch of learners, in all of its paths."""

    generic: Generic
    closed: LinearMeanOnly
    reward: QuadraticReward
    model: dict[str, Tensor]
    policy: dict[str, Tensor]
    noise: dict[str, Tensor]
    state: Tensor


def linear_case(
    n: int,
    m: int,
    steps: int,
    *,
    batch: int = 3,
    discount: float = 0.97,
    action_cost: bool = False,
    features: tuple[Features, Features] = (Identity, Identity),
) -> LinearCase:
    """A derivative model of n states and m actions, random and mildly unstable.

    features: of the model and of the policy, Identity or Affine.
    """
    g = torch.Generator().manual_seed(1000 * n + 10 * m + steps)
    of_model, of_policy = features
    model = DerivativeModel(n, m, of_model(n + m), torch.zeros(n, dtype=torch.float64))
    policy = LinearPolicy(n, m, of_policy(n))
    R = random_cost(g, m) if action_cost else torch.zeros(m, m, dtype=torch.float64)
    reward = QuadraticReward(random_cost(g, n), R)
    horizon = Horizon(steps, 0.05, discount, 0.05)
    choice = choose_path("closed_form", model, policy, reward, MeanOnly(), horizon)
    assert isinstance(choice.path, LinearMeanOnly)
    return LinearCase(
        generic=choice.generic,
        closed=choice.path,
        reward=reward,
        model={"weight": normal(g, batch, *model.weight.shape)},
        policy={"weight": normal(g, batch, *policy.weight.shape)},
        noise={},
        state=normal(g, batch, n),
    )


def same_value_and_gradient(
    found: ValueGradient, wanted: ValueGradient, tolerance: float = 1e-10
) -> None:
    """Assert that two paths agree, relatively; the gradient as a vector."""
    assert torch.allclose(found.value, wanted.value, rtol=tolerance, atol=0)
    difference = found.gradient["weight"] - wanted.gradient["weight"]
    size = wanted.gradient["weight"].flatten(1).norm(dim=-1)
    assert bool((difference.flatten(1).norm(dim=-1) <= tolerance * size).all())


def bicycle_learner(
    world: World, *, fit: Fit | None = None, method: Method = "auto", horizon: int = 30
) -> Learner:
    """The learner of section 4 with the faster rates, for the bicycle or any sim of its size."""
    n, m = len(world.spec.state), len(world.spec.action)
    model = DerivativeModel(n, m, Identity(n + m), world.period)
    policy = LinearPolicy(n, m, Identity(n), world.dtype)
    weights = torch.zeros(n, dtype=world.dtype)
    weights[0] = 10 * world.spec.state[0].scale ** 2
    weights[-1] = world.spec.state[-1].scale ** 2
    reward = QuadraticReward(torch.diag(weights), torch.zeros(m, m, dtype=world.dtype))
    steps = Horizon(horizon, 0.051, 1.0, 0.051)
    return Learner(
        model=model,
        policy=policy,
        fit=fit or SquaredError(10.0),
        noise=None,
        value=choose_path(method, model, policy, reward, MeanOnly(), steps).path,
        step_rule=SaturatedStep(0.3, 1.0),
        exploration=0.05,
    )


def bicycle_training(
    seeds: list[int], budget: Budget, *, sim: Sim | None = None, fit: Fit | None = None
) -> Training:
    """Learners on the bicycle."""
    world = World(sim or Bicycle())
    return Training(bicycle_learner(world, fit=fit), world, seeds, budget)


def next_state_model(n: int, m: int) -> NextStateModel:
    """Figure 1's model, linear in state and action."""
    return NextStateModel(n, m, Identity(n + m), torch.zeros(n, dtype=torch.float64))
