"""``edtorch.learn`` with presets that are no learner in its world: rivals, searches, files."""

from __future__ import annotations

import csv
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
import torch

import edtorch
from edtorch import Run
from sims.linear import LinearSystem
from tests.app.constant import Pieces
from tests.app.test_random_search import SMALL

QUICK = ("eval.episodes=3", "log.tensorboard=false", "log.figures=false", "compute.native=off")
CONSTANT = (
    "rival._target_=tests.app.constant.Constant",
    "rival.gain=-1.0",
    "policy=linear",
)


SYSTEM = LinearSystem([[1.5]], [[1.0]], noise=0.01, time_limit=40.0)
"""s' = 1.5 s + a: left alone it leaves its bounds within 20 steps; a = -s keeps it."""


def _learn(*overrides: str, **more: Any) -> Run:
    return edtorch.learn(SYSTEM, progress=False, overrides=(*QUICK, *overrides), **more)


def _untimed(run: Run) -> dict[str, Any]:
    return {name: value for name, value in run.summary.items() if name != "figures_s"}


def _same(run: Run, other: Run) -> None:
    assert other.seeds == run.seeds and _untimed(other) == _untimed(run)
    assert other.episodes == run.episodes
    assert other.evaluate(2) == run.evaluate(2)


def test_a_rival_is_a_run_like_a_learners(tmp_path: Path) -> None:
    run = _learn(*CONSTANT, seeds=2, seed=5, seconds=12)
    assert run.seeds == [5, 6] and run.episodes == []
    summary = run.summary
    assert summary["milestones"]["stable"]["seconds"]["per_seed"] == [6, 8]
    assert summary["return"]["max"] < 0 and summary["success_rate"]["per_seed"] == [1, 1]
    assert float(run.policy.predict([0.5])[0]) == -0.5
    _same(run, edtorch.load(run.save(tmp_path / "run"), env=SYSTEM, trust=["tests"]))
    with (tmp_path / "run" / "metrics.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 12


def test_an_interrupted_rival_leaves_its_policies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    advance = Pieces.advance

    def interrupted(search: Pieces, *arguments: Any) -> None:
        advance(search, *arguments)
        if search.accounts[0].episodes == 4:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Pieces, "advance", interrupted)
    run = _learn(*CONSTANT, seconds=1000)
    assert run.interrupted and run.summary["simulated_seconds"] == [8]
    folder = run.save(tmp_path / "run")
    assert json.loads((folder / "status.json").read_text())["status"] == "interrupted"
    assert not (folder / "summary.json").exists()
    assert float(edtorch.load(folder, env=SYSTEM, trust=True).policy.predict([0.5])[0]) == -0.5


def test_a_rival_refuses_a_policy_that_is_not_linear() -> None:
    with pytest.raises(ValueError, match=r"expected a policy linear in features with a rival"):
        _learn(*CONSTANT, policy=torch.nn.Sequential(torch.nn.Linear(1, 1), torch.nn.Tanh()))


def test_learners_of_recorded_transitions(tmp_path: Path) -> None:
    folder = tmp_path / "lived"
    _learn("log.transitions=true", seconds=20, save=folder)
    run = _learn("offline=recorded", f"offline.data={folder}", seconds=20)
    assert run.summary["simulated_seconds"] == [pytest.approx(20)]
    assert run.summary["failure_rate"]["per_seed"] == [0]
    _same(run, edtorch.load(run.save(tmp_path / "run"), env=SYSTEM))


def test_a_random_search_has_a_policy_for_each_that_arrives(tmp_path: Path) -> None:
    overrides = [each for each in SMALL if not each.startswith("experiment")]
    run = edtorch.learn(preset="footnote1", overrides=overrides, progress=False)
    assert len(run.policies) == len(run.seeds) == run.summary["goal"]["count"] > 0
    assert run.evaluate(2)["failure_rate"] == [0.0] * len(run.seeds)
    again = edtorch.load(run.save(tmp_path / "run"))
    assert again.seeds == run.seeds and again.evaluate(2) == run.evaluate(2)
