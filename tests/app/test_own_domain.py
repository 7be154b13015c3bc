"""A simulator of a user's own: a class, a file of configuration, and nothing changed in edtorch."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edtorch.app.domain import build_sim
from edtorch.app.errors import ConfigError
from edtorch.app.given import Given
from edtorch.app.settings import Settings
from sims.rows import Namespace, Rows
from sims.tasks.cart_pole import CartPole

SIM = '''
"""A cart on a rail."""

import torch

from sims.base import Outcome, Quantity, Spec


class Cart:
    def __init__(self, push: float = 1.0) -> None:
        if not push > 0:
            raise ValueError(f"push={push}: expected a number > 0")
        self.push = push
        self.spec = Spec(
            name="cart",
            state=(Quantity("place", "m"), Quantity("speed", "m/s")),
            action=(Quantity("force", "N", low=-1.0, high=1.0),),
            dt=0.05,
            time_limit=2.0,
            disturbance_dim=1,
            reset_dim=1,
            clip_action=True,
            headline="place",
        )

    def initial(self, uniforms):
        return torch.cat([2 * uniforms - 1, torch.zeros_like(uniforms)], -1)

    def restart(self, state, mask, uniforms):
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state, action, uniforms):
        place, speed = state.split(1, -1)
        speed = speed + 0.05 * (self.push * action + uniforms - 0.5)
        return torch.cat([place + 0.05 * speed, speed], -1)

    def observe(self, state):
        return state

    def outcome(self, state):
        return torch.where(state[..., 0].abs() < 3, int(Outcome.RUNNING), int(Outcome.FAILED))

    def measures(self, start, final, seconds):
        return {}
'''
YAML = "_target_: my_package.cart.Cart\npush: 2.0\n"


def test_own_domain(
    start: Callable[..., subprocess.Popen[str]],
    command: Callable[..., Any],
    workplace: Path,
    quick: tuple[str, ...],
    patience: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Trained in a process that finds it in its path; what else there is to see, in this one."""
    package = workplace / "src" / "my_package"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "cart.py").write_text(SIM)
    (workplace / "my_conf" / "domain").mkdir(parents=True)
    (workplace / "my_conf" / "domain" / "mine.yaml").write_text(YAML)
    arguments = (
        *("--config-dir", "my_conf", *quick, "domain=mine"),
        *("reward=quadratic", "+reward.state.place=1", "+reward.state.speed=1"),
    )
    source = str(workplace / "src")
    good = start("edtorch-train", *arguments, "hydra.run.dir=run", PYTHONPATH=source)
    _, err = good.communicate(timeout=patience)
    assert good.returncode == 0, err
    status = json.loads((workplace / "run" / "status.json").read_text())
    assert status["status"] == "done"
    monkeypatch.syspath_prepend(source)
    bad = command("edtorch-train", *arguments, "domain.push=-1", "hydra.run.dir=bad")
    assert bad.line == "edtorch-train: domain.push=-1.0: expected a number > 0"
    evaluation = command("edtorch-eval", "run=run", "episodes=2", "trust=[my_package]")
    assert evaluation.status == 0, evaluation.err
    assert "shaping reward, summed over time" in " ".join(evaluation.out.split())


def test_rows_that_are_incomplete_are_refused_in_one_line() -> None:
    class Narrow(CartPole):
        def rows(self, xp: Namespace) -> Rows:
            return replace(super().rows(xp), observe=lambda s, c: s[:3])

    with pytest.raises(
        ConfigError, match=r"^env: Narrow\.rows: observe returned 3 rows, expected 4"
    ):
        build_sim(Settings({"given": Given(Narrow())}))
