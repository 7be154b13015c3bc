"""PPO on a problem with a known answer, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import stable_baselines3
import torch

from edtorch.rivals.ppo import PPO
from edtorch.rivals.stable_baselines import BaselinesSearch
from tests.rivals.deep_problems import STARTS, actions, carry_on, largest_error, linear_problem

SMALL = {"copies": 64, "rollout": 8, "hidden": [32, 32], "learning_rate": 0.01, "discount": 0.0}


@pytest.mark.oracle
def test_finds_the_best_action() -> None:
    """One step from anywhere in [-1, 1]: the best action is linear in the state."""
    search = PPO(steps=2048, **SMALL).begin(linear_problem([0]))
    assert largest_error(search) > 0.3
    search.advance([True], carry_on)
    assert largest_error(search) < 0.12


def test_acts_as_its_models_predict() -> None:
    search = PPO(steps=512, **SMALL).begin(linear_problem([0, 1]))
    assert isinstance(search, BaselinesSearch)
    search.advance([True, True], carry_on)
    found = actions(search)
    for row, model in enumerate(search.models):
        wanted, _ = model.predict(STARTS.numpy().astype(np.float32), deterministic=True)
        torch.testing.assert_close(
            found[row], torch.from_numpy(wanted[:, 0]).double(), rtol=1e-5, atol=1e-6
        )
    assert not found[0].allclose(found[1], atol=1e-3)


def test_has_the_defaults_of_stable_baselines() -> None:
    search = PPO().begin(linear_problem([0]))
    assert isinstance(search, BaselinesSearch)
    assert tuple(search.parameters["weight_2"].shape) == (1, 64, 64)
    envs = search.models[0].env
    assert envs is not None
    model = stable_baselines3.PPO("MlpPolicy", envs, device="cpu")
    names = ("gamma", "learning_rate", "batch_size", "n_steps", "n_epochs", "gae_lambda")
    for name in names:
        assert getattr(search.models[0], name) == getattr(model, name), name


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({"steps": 0}, r"steps=0: expected an integer >= 1"),
        ({"copies": 0}, r"copies=0: expected an integer >= 1"),
        ({"rollout": 0}, r"rollout=0: expected an integer >= 1"),
        ({"copies": 3, "rollout": 7}, r"rollout=7: .* copies=3 is a multiple of 64"),
    ],
)
def test_refuses(settings: dict[str, int], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        PPO(**settings)  # pyright: ignore[reportArgumentType]
