"""Shaping rewards r(s, a), and their expectation under a belief (eq. 1)."""

from edtorch.derivatives import StateFunction, rowwise_jacobian
from edtorch.rewards.base import Reward, expected_reward, quadratic_form_of, target_of
from edtorch.rewards.lifted import LiftedReward
from edtorch.rewards.nearness import NearnessReward
from edtorch.rewards.physical import PhysicalReward
from edtorch.rewards.quadratic import QuadraticForm, QuadraticReward
from edtorch.rewards.saturating import SaturatingReward

__all__ = [
    "LiftedReward",
    "NearnessReward",
    "PhysicalReward",
    "QuadraticForm",
    "QuadraticReward",
    "Reward",
    "SaturatingReward",
    "StateFunction",
    "expected_reward",
    "quadratic_form_of",
    "rowwise_jacobian",
    "target_of",
]
