"""Which path is taken, and that it says why."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.model.features import Identity, Pairwise
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy, SquashedPolicy
from edtorch.rewards import QuadraticReward, Reward
from edtorch.transform import Cubature, FirstOrder, MeanOnly, SecondOrder, Transform
from edtorch.types import Belief
from edtorch.value.choose import choose_path
from edtorch.value.linear import LinearMeanOnly, LinearMoment
from edtorch.value.unroll import Generic, Horizon

HORIZON = Horizon(5, 0.05, 1.0, 0.05)
REWARD = QuadraticReward(torch.eye(2).double(), torch.zeros(1, 1).double())
PERIOD = torch.zeros(2, dtype=torch.float64)
LINEAR = DerivativeModel(2, 1, Identity(3), PERIOD)
CURVED = DerivativeModel(2, 1, Pairwise(3), PERIOD)
PLAIN = LinearPolicy(2, 1, Identity(2))


class OfMyOwn:
    """A transform that the dispatch has never heard of."""

    propagates_covariance = False
    differentiates_reward = False

    def keeps_positive(self, noise: StateFunction) -> bool:
        return True

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        return belief

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Tensor:
        return reward(belief.mean, policy(belief.mean))


def test_linear_loops_get_the_closed_form() -> None:
    choice = choose_path("auto", LINEAR, PLAIN, REWARD, MeanOnly(), HORIZON)
    assert isinstance(choice.path, LinearMeanOnly) and "closed form" in choice.reason
    noise = ResidualNoise(1.0)
    for transform in (FirstOrder(), SecondOrder(), Cubature()):
        choice = choose_path("auto", LINEAR, PLAIN, REWARD, transform, HORIZON, noise=noise)
        assert isinstance(choice.path, LinearMoment) and "covariance" in choice.reason
    choice = choose_path("generic", LINEAR, PLAIN, REWARD, MeanOnly(), HORIZON)
    assert isinstance(choice.path, Generic) and "asked for" in choice.reason


@pytest.mark.parametrize(
    ("model", "policy", "reward", "transform", "why"),
    [
        (CURVED, PLAIN, REWARD, MeanOnly(), "the model is not linear"),
        (LINEAR, SquashedPolicy(2, 1, Identity(2)), REWARD, MeanOnly(), "the policy is not linear"),
        (LINEAR, PLAIN, lambda s, a: -s[..., 0].cos(), MeanOnly(), "the reward is not quadratic"),
        (LINEAR, PLAIN, REWARD, FirstOrder(), "the noise is neither constant"),
        (LINEAR, PLAIN, REWARD, OfMyOwn(), "not known to be exact for linear loops"),
    ],
)
def test_everything_else_gets_the_generic_path(
    model: DerivativeModel, policy: LinearPolicy, reward, transform: Transform, why: str
) -> None:
    choice = choose_path("auto", model, policy, reward, transform, HORIZON)
    assert isinstance(choice.path, Generic) and why in choice.reason
    with pytest.raises(ValueError, match=why):
        choose_path("closed_form", model, policy, reward, transform, HORIZON)
