"""Saved and loaded, a learner goes on as if nothing had been; bad files are named."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from edtorch.model.fit import RecursiveLeastSquares
from edtorch.run.checkpoint import (
    FileProblem,
    PolicyCard,
    load_policy,
    load_training,
    save_policy,
    save_training,
    write_text,
)
from edtorch.run.episodes import Budget
from tests.systems import bicycle_training

CARD = PolicyCard("bicycle", ["lean"], ["torque"], [0.2, 2.0], "LinearPolicy(Identity)", [0, 1])
SHAPES = {"weight": (1, 1)}


def test_interrupted_equals_uninterrupted_bit_for_bit(tmp_path: Path) -> None:
    budget = Budget(seconds=8.0)

    def fresh():
        return bicycle_training([0, 1], budget, fit=RecursiveLeastSquares())

    whole, first, second = fresh(), fresh(), fresh()
    whole.advance(800)
    first.advance(333)
    save_training(tmp_path / "saved.pt", first)
    load_training(tmp_path / "saved.pt", second)
    second.advance(800 - 333)
    assert second.clock == whole.clock
    for name in ("model", "policy", "fit"):
        mine, theirs = getattr(second.learners, name), getattr(whole.learners, name)
        assert all(torch.equal(mine[k], theirs[k]) for k in theirs)
    assert torch.equal(second.worlds.world, whole.worlds.world)
    assert second.worlds.failures.tolist() == whole.worlds.failures.tolist()
    # Nothing is left beside the file.
    assert os.listdir(tmp_path) == ["saved.pt"]


def test_learners_that_were_done_go_on_waiting(tmp_path: Path) -> None:
    budget = Budget(seconds=20.0, episodes=3)
    first, second = (bicycle_training([0, 1, 2], budget) for _ in range(2))
    while bool(first.worlds.active.all()):
        first.advance(1)
    save_training(tmp_path / "saved.pt", first)
    load_training(tmp_path / "saved.pt", second)
    waiting = int((~first.worlds.active).nonzero()[0])
    before = second.worlds.world[waiting].clone()
    second.advance(50)
    assert torch.equal(second.worlds.world[waiting], before)
    first.advance(50)
    assert torch.equal(second.worlds.world, first.worlds.world)


def test_a_population_is_not_loaded_into_another(tmp_path: Path) -> None:
    save_training(tmp_path / "saved.pt", bicycle_training([0, 1], Budget(seconds=1.0)))
    with pytest.raises(FileProblem, match=r"seeds \[0, 1\], expected \[0, 2\]"):
        load_training(tmp_path / "saved.pt", bicycle_training([0, 2], Budget(seconds=1.0)))
    (tmp_path / "broken.pt").write_bytes(b"no archive")
    with pytest.raises(FileProblem, match="not a saved population"):
        load_training(tmp_path / "broken.pt", bicycle_training([0, 1], Budget(seconds=1.0)))


def test_policies_come_back_as_they_went(tmp_path: Path) -> None:
    policy = {"weight": torch.randn(2, 1, 1, dtype=torch.float64)}
    save_policy(tmp_path / "p.safetensors", policy, CARD)
    loaded = load_policy(tmp_path / "p.safetensors", CARD, SHAPES)
    assert torch.equal(loaded["weight"], policy["weight"])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("domain", "cardea", "made for domain bicycle, expected domain cardea"),
        ("states", ["tilt"], "made for states"),
        ("scales", [1.0, 2.0], "made for scales"),
        ("policy", "LinearPolicy(Affine)", "made for policy"),
        ("seeds", [0], "made for seeds"),
    ],
)
def test_a_policy_for_something_else_is_refused(
    tmp_path: Path, field: str, value: Any, message: str
) -> None:
    save_policy(tmp_path / "p.safetensors", {"weight": torch.zeros(2, 1, 1)}, CARD)
    expected = replace(CARD, **{field: value})
    with pytest.raises(FileProblem, match=message):
        load_policy(tmp_path / "p.safetensors", expected, SHAPES)


def test_a_policy_of_another_size_or_no_policy_is_refused(tmp_path: Path) -> None:
    save_policy(tmp_path / "p.safetensors", {"weight": torch.zeros(2, 1, 1)}, CARD)
    with pytest.raises(FileProblem, match=r"has shape \(2, 1, 1\), expected \(2, 1, 7\)"):
        load_policy(tmp_path / "p.safetensors", CARD, {"weight": (1, 7)})
    whole = (tmp_path / "p.safetensors").read_bytes()
    for content in (b"", b"junk" * 10, whole[: len(whole) // 2]):
        (tmp_path / "p.safetensors").write_bytes(content)
        with pytest.raises(FileProblem, match="not a saved policy"):
            load_policy(tmp_path / "p.safetensors", CARD, SHAPES)


def test_a_file_that_cannot_be_finished_leaves_the_old_one(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "old")
    with pytest.raises(UnicodeEncodeError):
        write_text(tmp_path / "a.txt", "\ud800")
    assert (tmp_path / "a.txt").read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]
