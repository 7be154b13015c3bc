"""The examples run, in short."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def example(name: str) -> dict[str, Any]:
    before = torch.get_default_dtype()
    try:
        return runpy.run_path(str(EXAMPLES / name))
    finally:
        torch.set_default_dtype(before)


def test_there_is_a_test_of_each() -> None:
    tests = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    assert all(path.name in tests for path in EXAMPLES.glob("*.py"))


@pytest.mark.oracle
def test_own_env() -> None:
    assert example("own_env.py")["main"](seconds=4.0)["failure_rate"] == [0.0]


@pytest.mark.oracle
def test_own_simulator() -> None:
    found = example("own_simulator.py")["main"](seconds=4.0, seeds=2)
    assert found["failure_rate"] == [0.0, 0.0]


@pytest.mark.oracle
def test_population() -> None:
    assert example("population.py")["main"](seconds=1.0, seeds=2)


@pytest.mark.oracle
def test_own_reward_and_policy() -> None:
    found = example("own_reward_and_policy.py")["main"](seconds=0.5, seeds=1)
    assert len(found["return"]) == 1


SHORT = {
    "inverted_pendulum": 1,
    "inverted_double_pendulum": 1,
    "pendulum": 11,
    "mountain_car": 100,
    "reacher": 3,
    "pusher": 6,
    "swimmer": 2,
    "lunar_lander": 4,
    "cartpole_balance": 1,
    "ball_in_cup": 1,
    "cart_pole": 4,
    "quadrotor": 3,
}
"""Simulated seconds in each environment."""
UNKNOWN = ("pendulum", "cartpole_balance", "ball_in_cup")
"""Those that neither fail nor say what a success is."""


# Box2D and glfw warn when they are imported; as an error that ends the process.
@pytest.mark.filterwarnings("ignore")
@pytest.mark.oracle
@pytest.mark.parametrize("name", SHORT)
def test_environments(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Imported by dm_control, absl keeps the stream of the moment, which pytest closes after a test.
    monkeypatch.setattr(sys, "stderr", sys.__stderr__)
    learn = example("environments.py")["ENVIRONMENTS"][name]
    quick = ("eval.episodes=0", "log.figures=false", "log.tensorboard=false")
    # Simulating dm_control's 1,000 steps takes seconds.
    limit = {"time_limit": 2.0} if name in ("cartpole_balance", "ball_in_cup") else {}
    run = learn(seconds=SHORT[name], overrides=quick, progress=False, **limit)
    found = run.evaluate(1)
    assert all(isinstance(r, float) for r in found["return"])
    assert (found["success_rate"] == [None]) == (name in UNKNOWN)
    assert found["failure_rate"] in ([0.0], [None]) or found["success_rate"] == [0.0]
    assert found["failure_rate"] == [None] or name not in UNKNOWN


def test_each_environment_is_tested() -> None:
    assert set(example("environments.py")["ENVIRONMENTS"]) == set(SHORT)
