"""The examples run, in short."""

from __future__ import annotations

import runpy
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
