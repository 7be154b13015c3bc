"""SAC on a problem with a known answer, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import stable_baselines3
import torch

from edtorch.rivals.sac import SAC
from edtorch.rivals.stable_baselines import BaselinesSearch
from tests.rivals.deep_problems import STARTS, actions, carry_on, largest_error, linear_problem

SMALL = {"hidden": [32, 32], "learning_rate": 0.01, "discount": 0.0, "reward_scale": 10.0}


@pytest.mark.oracle
def test_finds_the_best_action() -> None:
    """One step from anywhere in [-1, 1]: the best action is linear in the state."""
    search = SAC(steps=300, **SMALL).begin(linear_problem([0]))
    assert largest_error(search) > 0.3
    search.advance([True], carry_on)
    assert largest_error(search) < 0.12


def test_acts_as_its_models_predict() -> None:
    search = SAC(steps=110).begin(linear_problem([0, 1]))
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
    search = SAC().begin(linear_problem([0]))
    assert isinstance(search, BaselinesSearch)
    shapes = {name: tuple(p.shape) for name, p in search.parameters.items()}
    assert shapes == {
        "number": (1,),
        "weight_1": (1, 256, 1),
        "bias_1": (1, 256),
        "weight_2": (1, 256, 256),
        "bias_2": (1, 256),
        "weight_3": (1, 1, 256),
        "bias_3": (1, 1),
    }
    envs = search.models[0].env
    assert envs is not None
    model = stable_baselines3.SAC("MlpPolicy", envs, device="cpu")
    for name in ("gamma", "learning_rate", "batch_size", "tau", "learning_starts", "buffer_size"):
        assert getattr(search.models[0], name) == getattr(model, name), name


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({"steps": 0}, r"steps=0: expected an integer >= 1"),
        ({"growth": 0.9}, r"growth=0\.9: expected a number in \[1, 10\]"),
        ({"repeat": 0}, r"repeat=0: expected an integer >= 1"),
        ({"failure_penalty": -1.0}, r"failure_penalty=-1\.0: expected a finite number, 0 or more"),
        ({"reward_scale": 0.0}, r"reward_scale=0\.0: expected a finite number > 0"),
        ({"learning_rate": float("nan")}, r"learning_rate=nan: expected a finite number > 0"),
        ({"discount": 1.5}, r"discount=1\.5: expected a number in \[0, 1\]"),
        ({"hidden": []}, r"hidden=\[\]: expected units of each layer, 1 or more"),
        ({"hidden": [8, 0]}, r"hidden=\[8, 0\]: expected units of each layer, 1 or more"),
    ],
)
def test_refuses(settings: dict[str, object], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        SAC(**settings)  # pyright: ignore[reportArgumentType]


def test_says_how_to_get_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edtorch.rivals.deep.is_installed", lambda: False)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "edtorch\[rivals\]"'):
        SAC()
