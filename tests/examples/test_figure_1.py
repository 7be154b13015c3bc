"""The page with Figure 1 (examples/figure_1.py) does what ``Learner.step`` does."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from edtorch.learner.learner import Learner
from edtorch.model.features import Identity
from edtorch.model.fit import SquaredError
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import PlainStep
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder
from edtorch.types import Transition
from edtorch.value.choose import choose_path
from edtorch.value.unroll import Horizon
from tests.examples.test_examples import EXAMPLES, example
from tests.systems import next_state_model


@pytest.fixture
def page() -> Iterator[dict[str, Any]]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield example("figure_1.py")
    torch.set_default_dtype(before)


def test_it_is_one_page_of_torch() -> None:
    lines = Path(EXAMPLES / "figure_1.py").read_text().splitlines()
    assert len(lines) <= 100
    assert not [line for line in lines if line.startswith(("import edtorch", "from edtorch"))]


def test_it_equals_the_learner(page: dict[str, Any]) -> None:
    settings = page["Settings"]()
    model, policy = next_state_model(2, 1), LinearPolicy(2, 1, Identity(2))
    reward = QuadraticReward(torch.eye(2), torch.zeros(1, 1))
    noise, horizon = ResidualNoise(settings.noise_rate), Horizon(5, 1.0, settings.discount, 1.0)
    path = choose_path("generic", model, policy, reward, FirstOrder(), horizon, noise=noise).path
    learner = Learner(
        model=model,
        policy=policy,
        fit=SquaredError(settings.model_rate),
        noise=noise,
        value=path,
        step_rule=PlainStep(settings.alpha),
        exploration=0.0,
    )
    state = learner.initial([0])
    own = page["Learner"](torch.zeros(2, 3), torch.zeros(2, 2), torch.zeros(1, 2))
    generator = torch.Generator().manual_seed(1)
    valid = torch.tensor([True])
    for _ in range(30):
        s, a, s_next = (torch.randn(k, generator=generator) for k in (2, 1, 2))
        happened = Transition(s[None], a[None], s_next[None], torch.tensor(1.0), valid)
        state, metrics = learner.step(state, happened)
        own, value = page["tick"](own, s, a, s_next, settings)
        torch.testing.assert_close(state.model["weight"][0], own.W)
        torch.testing.assert_close(state.noise["nu"][0], own.nu)
        torch.testing.assert_close(state.policy["weight"][0], own.theta)
        assert metrics.value is not None
        torch.testing.assert_close(metrics.value[0], value)


def test_it_learns(page: dict[str, Any]) -> None:
    learned = page["main"](ticks=150)
    assert float(learned.theta[0, 1]) < 0
