"""One policy for all starts, from the command line and from Python."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

import edtorch
from tests.app.conftest import Result

SMALL = ("eval.episodes=20", "search.restarts=4", "search.draws=20", "train.episodes=3")


@pytest.mark.long
@pytest.mark.experiment
def test_gymnasiums_pendulum_is_held_up_after_seconds(tmp_path: Path) -> None:
    run = edtorch.learn(preset="gym_pendulum", seeds=2, overrides=SMALL, progress=False)
    assert run.summary["never_solved"] == []
    assert run.summary["seconds_to_solved"]["max"] <= 3
    assert all(e["seconds"] == pytest.approx(1) for e in run.episodes)
    again = edtorch.load(run.save(tmp_path / "pendulum"))
    assert again.evaluate(5) == run.evaluate(5)
    alone = edtorch.learn(preset="gym_pendulum", seed=1, overrides=SMALL, progress=False)
    for name, p in alone.policies[0].parameters.items():
        assert torch.equal(p, run.policies[1].parameters[name])


CHEAP = (
    *("search=gradient", "search/improver=adam", "search.improver.steps=3", "search.restarts=2"),
    *("search.draws=5", "search.horizon=1", "train.episodes=1", "eval.episodes=3"),
)


@pytest.mark.experiment
@pytest.mark.parametrize(
    "policy",
    [
        pytest.param(
            ("search/policy=rbf", "search.policy.centres=8", "search.improver.belief=cubature"),
            marks=pytest.mark.long,
            id="rbf",
        ),
        pytest.param(
            ("search/policy=mlp", "search.policy.hidden=[8]", "search.odd=true"), id="mlp"
        ),
    ],
)
def test_other_policies_are_saved_and_tried_again(policy: tuple[str, ...], tmp_path: Path) -> None:
    overrides = (*CHEAP, *policy)
    run = edtorch.learn(preset="pendulum_swingup", seeds=2, overrides=overrides, progress=False)
    again = edtorch.load(run.save(tmp_path / "pendulum"))
    assert again.evaluate(3) == run.evaluate(3)
    reading = torch.tensor([3.0, 0.1])
    for one, other in zip(run.policies, again.policies, strict=True):
        assert torch.equal(
            torch.as_tensor(one.predict(reading)), torch.as_tensor(other.predict(reading))
        )
    alone = edtorch.learn(preset="pendulum_swingup", seed=1, overrides=overrides, progress=False)
    for name, p in alone.policies[0].parameters.items():
        assert torch.equal(p, run.policies[1].parameters[name])


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("search.policy.degree=0", "search.policy.degree=0: expected an integer >= 1"),
        ("search.degree=0", "search.degree=0: expected an integer >= 1"),
        ("search/policy=mlp", "GaussNewton cannot improve a NetworkPolicy; expected"),
        ("search.trial=-1", "search.trial=-1.0: expected a number > 0, or null"),
        (
            "search.horizon=9",
            "search.horizon=9.0: expected seconds from 0.1 to 4, the length of an",
        ),
        ("search.spread=-1", "search.spread=-1.0: expected a number >= 0"),
        (
            "reward.rows=[{rate: 1, reference: [1, 2]}]",
            "gradient: expected a reward without a reference, which search=planned with",
        ),
    ],
)
def test_refuses_with_one_line(command: Callable[..., Result], argument: str, words: str) -> None:
    what = ("experiment=pendulum_swingup", "search=gradient")
    result = command("edtorch-train", *what, argument)
    assert result.status != 0
    assert words in result.line
