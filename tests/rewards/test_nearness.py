"""exp(-d^2 / 2): the reward that Gymnasium's registration of a task has."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from edtorch.rewards import NearnessReward, PhysicalReward
from sims.tasks.env import CartPoleSwingUpEnv

ROWS = [
    {"weight": 16, "position": 1, "sin angle": -0.5},
    {"weight": 16, "cos angle": 0.5, "constant": -0.5},
]


def test_it_is_that_of_the_registered_task() -> None:
    env, action = CartPoleSwingUpEnv(), torch.zeros(20, 1).double()
    spec, generator = env.sim.spec, torch.Generator().manual_seed(0)
    spread = torch.tensor([0.3, 1.0, 0.6, 1.0]).double()
    state = spread * torch.randn(20, 4, generator=generator, dtype=torch.float64)
    reward = NearnessReward(spec, ROWS)
    wanted = [env.reward(s, np.zeros(1), s) for s in state.numpy()]
    assert min(wanted) < 0.3 and max(wanted) > 0.8
    assert reward(state, action).tolist() == pytest.approx(wanted, rel=1e-12)
    scale = torch.tensor([q.scale for q in spec.state]).double()
    scaled = PhysicalReward(reward, scale, torch.full((1,), 10.0).double())
    assert scaled(state / scale, action).tolist() == pytest.approx(wanted, rel=1e-12)


def test_it_follows_nothing() -> None:
    with pytest.raises(ValueError, match="expected none with a reference"):
        NearnessReward(CartPoleSwingUpEnv().sim.spec, [{"rate": 1, "reference": [1.0, 2.0]}])
