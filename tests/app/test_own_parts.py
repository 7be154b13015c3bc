"""A user's own reward, policy and model from the command line, and what is refused in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edtorch.app.options import without_presets

PARTS = """
import torch
from torch import nn


class MLP(nn.Module):
    def __init__(self, states, actions, hidden=4):
        super().__init__()
        self.inside = nn.Linear(states, hidden)
        self.out = nn.Linear(hidden, actions)

    def forward(self, state):
        return self.out(torch.tanh(self.inside(state)))


class Net(nn.Module):
    def __init__(self, states, actions):
        super().__init__()
        self.layer = nn.Linear(states + actions, states)

    def forward(self, state, action):
        return torch.tanh(self.layer(torch.cat([state, action], -1)))


def bump(state, action, price=0.01):
    return torch.exp(-state.square().sum(-1)) - price * action.square().sum(-1)


def wide(state, action):
    return -state.square()
"""
LINEAR = (
    "domain=linear",
    "domain.state_matrix=[[1.0,0.05],[0.0,1.0]]",
    "domain.action_matrix=[[0.0],[0.05]]",
    "domain.dt=0.05",
    "reward=quadratic",
    "+reward.state.s0=1",
)
SHORT = ("train.seconds=0.5", "eval.episodes=0", "log.progress=false", "compute.native=off")
SEQUENTIAL = (
    "policy={_target_: torch.nn.Sequential,"
    " _args_: [{_target_: torch.nn.Linear, in_features: 2, out_features: 1}]}"
)


@pytest.fixture
def parts(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (workplace / "own_parts.py").write_text(PARTS)
    monkeypatch.syspath_prepend(str(workplace))
    monkeypatch.delitem(sys.modules, "own_parts", raising=False)


@pytest.mark.experiment
@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("given", "why"),
    [
        (("policy={_target_: own_parts.MLP, hidden: 3}",), "the policy is not linear"),
        ((SEQUENTIAL,), "the policy is not linear"),
        (("reward={_target_: own_parts.bump, price: 0.1}",), "the reward is not quadratic"),
        (("model={_target_: own_parts.Net}", "fit=gradient"), "the model is not linear"),
        (("+reward.target.s0=0.5", "reward.cross=[[s0,s1,0.1]]", "+reward.state.s1=1"), "affine"),
        (("reward=saturating", "+reward.width.s0=1.0", "transform=first"), "not quadratic"),
    ],
)
def test_own_parts_train(
    command: Callable[..., Any], quick: tuple[str, ...], given: tuple[str, ...], why: str
) -> None:
    # A group that is chosen again, without the keys that the quadratic reward had.
    base = [
        a for a in LINEAR if not (a.startswith(("reward", "+reward")) and "reward=" in given[0])
    ]
    result = command("edtorch-train", *quick, *base, *SHORT, "hydra.run.dir=run", *given)
    assert result.status == 0, result.err
    assert why in result.err
    # What was typed is what is kept.
    assert given[0] in Path("run/run.json").read_text().replace('\\"', '"')


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("given", "line"),
    [
        (("+reward.target.s9=1",), "reward.target.s9=1: expected one of state_0,"),
        (("+reward.target.s1=1",), "reward.target.s1=1: has no effect without reward.state"),
        (("+reward.target.s0=q",), "reward.target.s0=q: expected a number, or another component"),
        (
            ("reward.cross=[[s0,s1]]",),
            "reward.cross[0]=['state_0', 'state_1']: expected [NAME, NAME, WEIGHT]",
        ),
        (("reward.cross=[[s0,s1,9]]",), "reward: state_cost has eigenvalue"),
        (
            ("policy={_target_: own_parts.bump}",),
            "policy._target_=own_parts.bump: expected the full",
        ),
        (("policy={_target_: fractions.Fraction}",), "Fraction has no action(parameters, state)"),
        (("policy={_target_: own_parts.MLP, hiden: 3}",), "did you mean policy.hidden?"),
        (("policy={_target_: own_parts.Net}",), "policy._target_=own_parts.Net: "),
        (("model={_target_: own_parts.Net}",), "expected fit=gradient with model._target_="),
        (("fit=local",), "model.features=identity: expected features that begin with 1 and"),
        (
            ("fit=local", "domain.action_matrix=[[0.0,0.1],[0.05,0.0]]"),
            "model.features=identity: expected features that begin with 1 and",
        ),
    ],
)
def test_refusals(command: Callable[..., Any], given: tuple[str, ...], line: str) -> None:
    result = command("edtorch-train", *LINEAR, *given)
    assert result.status == 1
    assert line in result.line


def test_what_a_preset_sets_in_a_group_is_not_for_an_option_written_out() -> None:
    reward = {"_target_": "my.bump", "price": 0.1, "by_scale": True}
    step = {"_target_": "my.Step", "size": 2, "alpha": 3}
    found = without_presets(
        {"reward": reward, "step": step, "model": {"features": "affine"}},
        ["model=derivative", "reward={_target_: my.bump, price: 0.1}", "+step={}", "step.size=2"],
    )
    assert found == {
        "reward": {"_target_": "my.bump", "price": 0.1},
        "step": {"size": 2},
        "model": {"features": "affine"},
    }


@pytest.mark.usefixtures("parts")
def test_a_reward_of_another_shape_is_refused(command: Callable[..., Any]) -> None:
    result = command("edtorch-train", *LINEAR[:4], "reward={_target_: own_parts.wide}")
    assert "reward._target_=own_parts.wide: gives (3, 2) for states of shape (3, 2)" in result.line
